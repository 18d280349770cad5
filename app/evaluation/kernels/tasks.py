"""All tasks by name."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence

import numpy as np

from app.engine.types import Progress
from app.evaluation.errors import OptionsError
from app.evaluation.kernels.cold import cold_start
from app.evaluation.kernels.contour import magcom_mad, magcom_pose
from app.evaluation.kernels.dtw import Timed, dtw_f32, dtw_itakura_3d, dtw_u16, subsequence_dtw
from app.evaluation.kernels.filtering import particle_step
from app.evaluation.kernels.mapping import map_build
from app.evaluation.kernels.runner import Comparison, Row, Units, compare

Task = Callable[[np.random.Generator], Comparison]
_NO_PEER = "dtaidistance is not installed: pip install 'isodyn[bench]'"


def _warping(timed: Callable[[np.random.Generator], Timed], what: str, peer: str) -> Task:
    """A task of warping, which does the same number of windows or searches as its peer."""

    def task(rng: np.random.Generator) -> Comparison:
        ours, theirs, units = timed(rng)
        return Comparison(ours, theirs, Units(what, peer, units, units, "" if theirs else _NO_PEER))

    return task


TASKS: tuple[tuple[str, Task], ...] = (
    ("dtw_f32", _warping(dtw_f32, "a window of 120, float32", "dtaidistance distance_matrix_fast")),
    ("dtw_u16", _warping(dtw_u16, "a window of 120, uint16", "dtaidistance distance_matrix_fast")),
    (
        "dtw_itakura_3d",
        _warping(dtw_itakura_3d, "a window of 120, three channels", "dtaidistance dtw_ndim.distance_fast, no Itakura"),
    ),
    (
        "subsequence_dtw",
        _warping(subsequence_dtw, "a search of 100,000 points with the path", "dtaidistance subsequence_alignment"),
    ),
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
