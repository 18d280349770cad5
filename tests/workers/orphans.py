"""A service in miniature for the orphan test: starts a pool, gives one worker endless work, says who they are."""

import multiprocessing
import sys
import time
from pathlib import Path

from app.workers.processes import ProcessExecutor
from tests.workers import sample_tasks


def main() -> None:
    pool = ProcessExecutor(2, multiprocessing.get_context("forkserver"), warm_up=sample_tasks.warm)
    pool.start()
    pool.submit(sample_tasks.spin, Path(sys.argv[1]))
    while pool.alive < 2 or not Path(sys.argv[1]).exists():
        time.sleep(0.01)
    sys.stdout.write("workers " + " ".join(map(str, pool.pids)) + "\n")
    sys.stdout.flush()
    if "leave" in sys.argv:
        raise SystemExit(7)
    while True:
        time.sleep(60)


if __name__ == "__main__":
    main()
