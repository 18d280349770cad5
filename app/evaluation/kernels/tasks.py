"""All tasks by name."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence

import numpy as np

from app.engine.types import Progress
from app.evaluation.errors import OptionsError
from app.evaluation.kernels.cold import cold_start
from app.evaluation.kernels.contour import magcom_mad, magcom_pose
from app.evaluation.kernels.filtering import particle_step
from app.evaluation.kernels.mapping import map_build
from app.evaluation.kernels.runner import Comparison, Row, compare

Task = Callable[[np.random.Generator], Comparison]
TASKS: tuple[tuple[str, Task], ...] = (
    ("magcom_mad", magcom_mad),
    ("magcom_pose", magcom_pose),
    ("particle_step", particle_step),
    ("map_build", map_build),
    ("cold_start", cold_start),
)


def run_kernels(
    only: Sequence[str] = (), *, rounds: int = 9, most_s: float = 20.0, progress: Progress | None = None
) -> list[Row]:
    """Run tasks one after the other.

    Parameters
    ----------
    only : sequence of str
        Names of the tasks wanted; empty: all.
    rounds, most_s
        As in :func:`compare`.
    progress : callable or None

    Raises
    ------
    OptionsError
        A task that is not known.
    """
    tasks = dict(TASKS)
    if unknown := [name for name in only if name not in tasks]:
        raise OptionsError("only", f"no task {', '.join(unknown)}; there are {', '.join(tasks)}")
    names = [name for name in tasks if not only or name in only]
    rows = []
    for k, name in enumerate(names):
        if progress:
            progress(k / len(names), name)
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        rows.append(compare(name, tasks[name](rng), rounds=rounds, most_s=most_s))
    return rows
