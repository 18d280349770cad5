"""Ids: ``<prefix>_<12 hex of Unix milliseconds><14 random hex>``, so that they sort by age and page lists."""

from __future__ import annotations

import hashlib
import secrets
import threading
from datetime import datetime

_RANDOM_BITS = 56
_STEP_BITS = 32


class IdFactory:
    """Makes ids that never go backwards within a process.

    Two ids of one millisecond would sort by chance, and a clock that is set back would sort new things before
    old ones. Both would make pages skip or repeat rows, so such an id continues from the last one made.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = 0

    def __call__(self, prefix: str, now: datetime) -> str:
        """Return a fresh id for a thing created ``now``."""
        value = (int(now.timestamp() * 1000) << _RANDOM_BITS) | secrets.randbits(_RANDOM_BITS)
        with self._lock:
            if value >> _RANDOM_BITS <= self._last >> _RANDOM_BITS:
                value = self._last + 1 + secrets.randbits(_STEP_BITS)
            self._last = value
        return f"{prefix}_{value:026x}"


new_id = IdFactory()


def seed_of(text: str) -> int:
    """Seed of a random generator derived from a name (SHA-256), 0 <= seed < 2**63."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1
