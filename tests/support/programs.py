"""Programs that are not Python packages: a browser for the dashboard's tests, a broker for MQTT."""

from __future__ import annotations

import os
import shutil

import pytest

REQUIRE = "ISODYN_REQUIRE_SERVERS"
"""Set (``.ci/run`` does) where a missing program must fail its tests; elsewhere they are skipped with a reason."""

SYSTEM = "/usr/sbin"
"""Where Debian puts servers; not in the search path of most users."""


def program(*names: str) -> str:
    """Path of the first of these programs at hand; without any the test is skipped, or fails if ``REQUIRE`` is set."""
    path = f"{os.environ.get('PATH', os.defpath)}{os.pathsep}{SYSTEM}"
    for name in names:
        if found := shutil.which(name, path=path):
            return found
    reason = f"needs {' or '.join(names)}: install it (Debian: apt-get install {names[0]})"
    if os.environ.get(REQUIRE):
        pytest.fail(f"{reason}; {REQUIRE} is set, so it is not skipped")
    pytest.skip(reason)
