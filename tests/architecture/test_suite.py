"""The tests' own tools: what is skipped, and how processes share compiled kernels."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.kernels import KernelLocks
from tests.support.programs import REQUIRE, program


def test_a_missing_program_skips_and_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(REQUIRE, raising=False)
    with pytest.raises(pytest.skip.Exception, match="apt-get install no-such-browser"):
        program("no-such-browser")


def test_a_missing_program_fails_where_it_is_required(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REQUIRE, "1")
    with pytest.raises(pytest.fail.Exception, match=REQUIRE):
        program("no-such-browser", "nor-this")


def test_a_program_is_found_in_the_search_path_and_among_servers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = tmp_path / "a-server"
    server.touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert program("no-such-browser", "a-server") == str(server)
    monkeypatch.setenv("PATH", os.devnull)
    monkeypatch.setattr("tests.support.programs.SYSTEM", str(tmp_path))
    assert program("a-server") == str(server)


HOLDER = """
import sys
from pathlib import Path
from tests.support.kernels import KernelLocks
with KernelLocks(Path(sys.argv[1])).of("kernel"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_kernels_lock_holds_between_processes_and_nests_within_one(tmp_path: Path) -> None:
    locks = KernelLocks(tmp_path)
    with locks.of("kernel"), locks.of("kernel"), locks.of("another"):
        pass
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with process as holder, (tmp_path / "kernel").open("w") as file:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        holder.communicate()
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
