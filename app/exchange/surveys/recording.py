"""Recordings of others cut into survey walks, with an account of what was read and what was not."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import BoolArray, Float64Array, ImuSamples, IntArray, RadioScans, SurveyWalk, Waypoints

MAX_GAP_S = 1.0
MAX_WALK_S = 1800.0
MAX_WALK_SAMPLES = 200_000
MIN_RATE_HZ = 8.0
"""What the service takes as one walk; recordings are cut to fit."""
MAX_VALUE = 1e9
"""No sensor reads more in any unit; what does is taken for no reading."""
MIN_WAYPOINT_S = 1.0
"""Positions that come more often are thinned: a leg between two of them should hold a step or two."""
FLOOR_SLACK_S = 2.0
"""Samples kept before the first and after the last position on a floor, of a recording that goes over several."""
MAX_FROM_ANCHOR_M = 50_000.0
"""Farther away a position is no place of the venue: a wrong anchor, or latitude and longitude interchanged."""
DEFAULT_START_S = 1_577_836_800.0
"""2020-01-01T00:00Z: when recordings begin that do not say it. A fixed time, so that reading twice gives one walk."""


@dataclass
class Findings:
    """What was read of a file, what was assumed, and what was left out and why; all in words."""

    read: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)

    def assume(self, words: str) -> None:
        """Note an assumption, once."""
        if words not in self.assumed:
            self.assumed.append(words)

    def lines(self) -> Iterator[str]:
        """All of it, a line each."""
        for title, notes in (("read", self.read), ("taken", self.assumed), ("left out", self.skipped)):
            for note in notes:
                yield f"{title}: {note}"


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One recording on one clock.

    Attributes
    ----------
    name : str
    samples : ImuSamples
    waypoints : Waypoints
    floors : tuple of str
        Of each waypoint; empty where the file tells none.
    wifi, ble : RadioScans or None
    """

    name: str
    samples: ImuSamples
    waypoints: Waypoints
    floors: tuple[str, ...] = ()
    wifi: RadioScans | None = None
    ble: RadioScans | None = None


def walks_of(recording: Recording, floor: str | None, findings: Findings) -> Iterator[SurveyWalk]:
    """Cut a recording into walks on one floor, without gaps and short enough.

    Parameters
    ----------
    recording : Recording
    floor : str or None
        Only what lies there. None: the only floor of the recording.
    findings : Findings
        Is told what was left out.

    Raises
    ------
    InputError
        The recording goes over several floors and none is named.
    """
    parts = list(_on_floor(recording, floor, findings))
    pieces = [piece for part in parts for piece in _pieces(part)]
    for number, piece in enumerate(pieces, start=1):
        name = recording.name if len(pieces) == 1 else f"{recording.name} {number}"
        walk = _walk(replace(piece, name=name), findings)
        if walk is not None:
            yield walk


def _on_floor(recording: Recording, floor: str | None, findings: Findings) -> Iterator[Recording]:
    """Stretches of a recording on a floor."""
    found = list(dict.fromkeys(recording.floors))
    if floor is None and len(found) > 1:
        raise InputError("floor", f"is not named, and {recording.name} goes over {', '.join(found)}; name one of them")
    if floor is None or not found or found == [floor]:
        yield recording
        return
    if floor not in found:
        findings.skipped.append(f"{recording.name}: no position on floor {floor}, only on {', '.join(found)}")
        return
    other = [one for one in found if one != floor]
    findings.skipped.append(f"{recording.name}: what lies on other floors ({', '.join(other)})")
    codes = np.array([one == floor for one in recording.floors])
    for run in np.split(np.arange(len(codes)), np.flatnonzero(np.diff(codes)) + 1):
        if codes[run[0]]:
            yield _between(recording, run)


def _between(recording: Recording, run: IntArray) -> Recording:
    points = recording.waypoints
    chosen = Waypoints(points.t[run], points.x[run], points.y[run])
    t = recording.samples.t
    near = (t >= chosen.t[0] - FLOOR_SLACK_S) & (t <= chosen.t[-1] + FLOOR_SLACK_S)
    return replace(recording, samples=_chosen(recording.samples, near), waypoints=chosen, floors=())


def _chosen(samples: ImuSamples, rows: BoolArray | IntArray | slice) -> ImuSamples:
    return ImuSamples(samples.t[rows], samples.mag[rows], samples.acc[rows], samples.gyro[rows])


def _pieces(recording: Recording) -> Iterator[Recording]:
    """Stretches without a gap, none longer than a walk may be."""
    t = recording.samples.t
    if not len(t):
        return
    bounds = [0, *(np.flatnonzero(np.diff(t) > MAX_GAP_S) + 1).tolist(), len(t)]
    for start, stop in itertools.pairwise(bounds):
        for first in _starts(t, start, stop):
            last = min(stop, first + MAX_WALK_SAMPLES, int(np.searchsorted(t, t[first] + MAX_WALK_S, "right")))
            yield _within(recording, slice(first, last))


def _starts(t: Float64Array, start: int, stop: int) -> Iterator[int]:
    while start < stop:
        yield start
        start = min(stop, start + MAX_WALK_SAMPLES, int(np.searchsorted(t, t[start] + MAX_WALK_S, "right")))


def _within(recording: Recording, rows: slice) -> Recording:
    samples = _chosen(recording.samples, rows)
    low, high = samples.t[0] - MAX_GAP_S, samples.t[-1] + MAX_GAP_S
    points = recording.waypoints
    inside = (points.t >= low) & (points.t <= high)
    return replace(
        recording,
        samples=samples,
        waypoints=Waypoints(points.t[inside], points.x[inside], points.y[inside]),
        wifi=_heard(recording.wifi, low, high),
        ble=_heard(recording.ble, low, high),
    )


def _heard(scans: RadioScans | None, low: float, high: float) -> RadioScans | None:
    if scans is None:
        return None
    rows = np.flatnonzero((scans.t >= low) & (scans.t <= high))
    return RadioScans(scans.t[rows], tuple(scans.address[i] for i in rows), scans.rssi[rows]) if len(rows) else None


def _walk(piece: Recording, findings: Findings) -> SurveyWalk | None:
    points = thinned(piece.waypoints)
    n, seconds = len(piece.samples), float(piece.samples.t[-1] - piece.samples.t[0])
    what = f"{piece.name}: {seconds:.0f} s, {n} samples"
    if len(points) < 2:
        findings.skipped.append(f"{what}: {len(points)} positions within it, two are needed to place a walk")
        return None
    if np.hypot(np.ptp(points.x), np.ptp(points.y)) < 1.0:
        findings.skipped.append(f"{what}: all positions within a metre; a recording at one place makes no map")
        return None
    if n < 2 or np.median(np.diff(piece.samples.t)) > 1.0 / MIN_RATE_HZ:
        findings.skipped.append(f"{what}: fewer than {MIN_RATE_HZ:g} samples a second do not show steps")
        return None
    length = float(np.hypot(np.diff(points.x), np.diff(points.y)).sum())
    findings.read.append(f"{what}, {len(points)} positions, {length:.0f} m")
    return SurveyWalk(piece.name, piece.samples, points, piece.wifi, None, piece.ble)


def thinned(points: Waypoints) -> Waypoints:
    """Positions in time order, at least ``MIN_WAYPOINT_S`` apart."""
    order = np.argsort(points.t, kind="stable")
    t = points.t[order]
    keep: list[int] = []
    last = -np.inf
    for i in range(len(t)):
        if t[i] - last >= MIN_WAYPOINT_S:
            keep.append(i)
            last = t[i]
    rows = order[np.array(keep, dtype=np.int64)]
    return Waypoints(points.t[rows], points.x[rows], points.y[rows])


def placed(
    latitude: Float64Array, longitude: Float64Array, plane: TangentPlane | None, field_name: str
) -> tuple[Float64Array, Float64Array]:
    """Level metres of places.

    Raises
    ------
    InputError
        There is no anchor, or a place is 50 km away from it.
    """
    if plane is None:
        raise InputError(field_name, "needs an anchor to become level metres; set the venue's, or give --anchor")
    x, y = plane.from_wgs84(latitude, longitude)
    near = np.hypot(x, y) <= MAX_FROM_ANCHOR_M
    if not near.all():
        i = int(near.argmin())
        raise InputError(
            field_name,
            f"{latitude[i]:.5f}, {longitude[i]:.5f} lies more than {MAX_FROM_ANCHOR_M / 1000:.0f} km from the venue's "
            "anchor; correct the anchor, or the order of latitude and longitude",
        )
    return x, y


def rising(t: Float64Array) -> BoolArray:
    """Mask of the values that are above all before them."""
    highest = np.maximum.accumulate(t)
    mask = np.ones(len(t), dtype=bool)
    mask[1:] = t[1:] > highest[:-1]
    return mask


def enough(counted: int, of: int, first: str, findings: Findings) -> None:
    """Note lines that could not be read; InputError if they are more than one in twenty: then it is another format."""
    if counted == 0:
        return
    if counted > 0.05 * of:
        raise InputError(first, f"cannot be read, nor can {counted - 1} of {of} others; is this the format you named?")
    findings.skipped.append(f"{counted} of {of} lines that cannot be read; the first: {first}")


def span(values: Sequence[float] | Float64Array) -> float:
    """Difference between the largest and the smallest."""
    return float(np.ptp(values)) if len(values) else 0.0
