"""Radio layer of a map: signal strengths of access points and beacons, learned from survey walks.

Wi-Fi and BLE addresses share one list in a :class:`~app.engine.types.RadioMap`. So that they cannot collide, BLE
addresses carry the prefix ``ble:`` there; :func:`merge_readings` puts it on, for the survey and for the likelihood
(:mod:`app.engine.localization.radio`) alike, and nobody else needs to. Addresses are compared in lower case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from app.engine.mapping.samples import PlacedSamples
from app.engine.mapping.transmitters import CellReadings, StrengthModel, fit_strength
from app.engine.types import BoolArray, Float32Array, Float64Array, IntArray, RadioMap, RadioScans, SurveyWalk

BLE_PREFIX = "ble:"
_REPEATED_S = 0.05
"""A platform reports its last reading of a transmitter again and again: same time, same strength."""
_TRACK_END_S = 1.0
_CHUNK = 1 << 22
_MAX_VALUES = 60_000_000
_MEAN_BINS = np.arange(-110.0, -30.0, 3.0)


@dataclass(frozen=True, slots=True)
class RadioSettings:
    """How the radio layer is built; fitted on left-out walks.

    Attributes
    ----------
    cell_m : float, m
        Distance of the nodes; larger where the layer would not fit into memory.
    margin_m : float, m
        How far the grid reaches beyond the survey.
    least_readings, least_walks : int
        A transmitter with fewer is dropped: what one walk met may have been somebody's phone.
    scan_s : float, s
        Readings of a walk within this time count as one scan.
    seen_length_m : float, m
        Distance over which the share of scans that report a transmitter changes.
    seen_prior : float
        Scans that the strength's word about being reported is worth.
    strength : StrengthModel
    """

    cell_m: float = 3.0
    margin_m: float = 9.0
    least_readings: int = 3
    least_walks: int = 2
    scan_s: float = 1.0
    seen_length_m: float = 4.0
    seen_prior: float = 1.0
    strength: StrengthModel = field(default_factory=StrengthModel)


@dataclass(frozen=True, slots=True)
class Readings:
    """Radio readings in time order: ``t`` (m,) s, ``name`` (m,) of transmitters, ``rssi`` (m,) dBm."""

    t: Float64Array
    name: tuple[str, ...]
    rssi: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])


def merge_readings(wifi: RadioScans | None, ble: RadioScans | None) -> Readings:
    """Wi-Fi and BLE readings as one list, BLE with its prefix, each reading once."""
    t = np.concatenate([scans.t for scans in (wifi, ble) if scans is not None] or [np.empty(0)])
    rssi = np.concatenate([scans.rssi for scans in (wifi, ble) if scans is not None] or [np.empty(0)])
    names = [] if wifi is None else [address.lower() for address in wifi.address]
    names += [] if ble is None else [BLE_PREFIX + address.lower() for address in ble.address]
    if not names:
        return Readings(t, (), rssi)
    name = np.array(names)
    order = np.lexsort((t, name))
    again = (name[order][1:] == name[order][:-1]) & (np.diff(t[order]) < _REPEATED_S)
    rows = order[np.concatenate(([True], ~again))]
    rows = rows[np.argsort(t[rows], kind="stable")]
    return Readings(t[rows], tuple(names[i] for i in rows), rssi[rows].astype(np.float64))


def build_radio_map(
    walks: Sequence[SurveyWalk], placed: Sequence[PlacedSamples], settings: RadioSettings | None = None
) -> RadioMap | None:
    """Learn the radio layer of a level.

    Parameters
    ----------
    walks : sequence of SurveyWalk
        Their ``wifi`` and ``ble`` are used.
    placed : sequence of PlacedSamples
        The walks as far as they could be placed, found by ``walk_id``; a reading belongs where the walker was at its
        time.
    settings : RadioSettings

    Returns
    -------
    RadioMap or None
        None if no transmitter was heard often enough.
    """
    settings = settings or RadioSettings()
    survey = _place(walks, placed)
    kinds = [survey.of(ble) for ble in (False, True)]
    kinds = [kind for kind in (_well_known(kind, settings) for kind in kinds) if len(kind)]
    if not kinds:
        return None
    transmitters = sum(len(kind.names) for kind in kinds)
    x, y, cell_m = _axes(np.concatenate([kind.xy for kind in kinds]), transmitters, settings)
    layers = [_layers(kind, x, y, settings) for kind in kinds]
    names = np.concatenate([np.array(kind.names)[layer.kept] for kind, layer in zip(kinds, layers, strict=True)])
    order = np.argsort(names)
    if not len(order):
        return None
    shape = (len(order), len(y), len(x))
    mean, sd, seen = (
        np.concatenate(parts)[order].reshape(shape) for parts in zip(*(layer.values for layer in layers), strict=True)
    )
    return RadioMap(
        x0=float(x[0]),
        y0=float(y[0]),
        cell_m=cell_m,
        addresses=tuple(str(name) for name in names[order]),
        mean=np.clip(np.rint(mean), -128, 127).astype(np.int8),
        sd=np.clip(np.rint(10.0 * sd), 1, 255).astype(np.uint8),
        seen=np.clip(np.rint(255.0 * seen), 0, 255).astype(np.uint8),
    )


@dataclass(frozen=True, slots=True)
class _Survey:
    """Placed readings: ``xy`` (n, 2) m, ``t`` (n,) s, ``rssi`` (n,) dBm, ``walk`` (n,), ``transmitter`` (n,) rows of
    ``names``."""

    xy: Float64Array
    t: Float64Array
    rssi: Float64Array
    walk: IntArray
    transmitter: IntArray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def of(self, ble: bool) -> _Survey:
        """Readings of one kind of radio."""
        return self.only(np.array([name.startswith(BLE_PREFIX) == ble for name in self.names], dtype=bool))

    def only(self, transmitters: BoolArray) -> _Survey:
        """Readings of some transmitters, given as a mask over ``names``."""
        rows = transmitters[self.transmitter]
        number = np.cumsum(transmitters) - 1
        names = tuple(name for name, keep in zip(self.names, transmitters, strict=True) if keep)
        return _Survey(
            self.xy[rows], self.t[rows], self.rssi[rows], self.walk[rows], number[self.transmitter[rows]], names
        )


def _place(walks: Sequence[SurveyWalk], placed: Sequence[PlacedSamples]) -> _Survey:
    tracks = {track.walk_id: track for track in placed}
    names: list[str] = []
    parts: list[tuple[Float64Array, ...]] = [(np.empty(0),) * 5]
    for number, walk in enumerate(walks):
        track = tracks.get(walk.walk_id)
        readings = merge_readings(walk.wifi, walk.ble)
        if track is None or not len(readings):
            continue
        known = (readings.t >= track.t[0] - _TRACK_END_S) & (readings.t <= track.t[-1] + _TRACK_END_S)
        t = readings.t[known]
        at = [np.interp(t, track.t, track.xy[:, axis]) for axis in (0, 1)]
        parts.append((at[0], at[1], t, readings.rssi[known], np.full(t.shape, float(number))))
        names += [readings.name[i] for i in np.flatnonzero(known)]
    px, py, t, rssi, owner = (np.concatenate(column) for column in zip(*parts, strict=True))
    known_names, transmitter = np.unique(np.array(names, dtype=np.str_), return_inverse=True)
    return _Survey(
        np.stack([px, py], axis=1),
        t,
        rssi,
        owner.astype(np.int64),
        transmitter.astype(np.int64),
        tuple(str(name) for name in known_names),
    )


def _well_known(survey: _Survey, settings: RadioSettings) -> _Survey:
    """Without transmitters that were met too seldom, or in too few walks."""
    n = len(survey.names)
    met = np.unique(np.stack([survey.transmitter, survey.walk], axis=1), axis=0)[:, 0]
    readings, walks = np.bincount(survey.transmitter, minlength=n), np.bincount(met, minlength=n)
    return survey.only((readings >= settings.least_readings) & (walks >= settings.least_walks))


def _axes(xy: Float64Array, transmitters: int, settings: RadioSettings) -> tuple[Float64Array, Float64Array, float]:
    """Node coordinates, multiples of the cell."""
    lo, hi = xy.min(axis=0) - settings.margin_m, xy.max(axis=0) + settings.margin_m
    cell_m = settings.cell_m
    while np.prod((hi - lo) / cell_m + 2.0) * transmitters > _MAX_VALUES:
        cell_m *= 2.0
    first, last = np.floor(lo / cell_m).astype(np.int64), np.ceil(hi / cell_m).astype(np.int64)
    return np.arange(first[0], last[0] + 1) * cell_m, np.arange(first[1], last[1] + 1) * cell_m, cell_m


@dataclass(frozen=True, slots=True)
class _Layers:
    """Mean (dBm), deviation (dB) and probability of the ``kept`` transmitters (rows of the survey's names)."""

    kept: IntArray
    values: tuple[Float32Array, Float32Array, Float32Array]


def _layers(survey: _Survey, x: Float64Array, y: Float64Array, settings: RadioSettings) -> _Layers:
    cells = CellReadings.of(survey.xy, survey.rssi, survey.walk, survey.transmitter, settings.strength)
    strength = fit_strength(cells, x, y, settings.strength)
    heard, scanned = _heard(survey, x, y, settings)
    heard, mean = heard[strength.kept], strength.mean
    prior = _share_at_strength(mean, heard, scanned)
    seen = (heard + settings.seen_prior * prior) / (scanned + settings.seen_prior)
    return _Layers(strength.kept, (mean, strength.sd, seen.astype(np.float32)))


def _heard(
    survey: _Survey, x: Float64Array, y: Float64Array, settings: RadioSettings
) -> tuple[Float32Array, Float32Array]:
    """Scans near each node that reported each transmitter, (transmitters, nodes), and all scans there, (nodes,).

    A scan counts ``exp(-distance / seen_length_m)``.
    """
    window = np.stack([survey.walk, np.floor(survey.t / settings.scan_s).astype(np.int64)], axis=1)
    _, scan = np.unique(window, axis=0, return_inverse=True)
    scan = scan.ravel()
    n = int(scan.max()) + 1
    count = np.bincount(scan, minlength=n)
    at = np.stack([np.bincount(scan, survey.xy[:, axis], n) / count for axis in (0, 1)], axis=1)
    reported = sparse.csr_matrix(
        (np.ones(len(scan), np.float32), (survey.transmitter, scan)), shape=(len(survey.names), n)
    )
    reported.data = np.minimum(reported.data, 1.0)  # building the matrix has added repeated readings up
    xx, yy = (axis.ravel() for axis in np.meshgrid(x, y))
    heard = np.empty((len(survey.names), xx.shape[0]), np.float32)
    scanned = np.empty(xx.shape[0], np.float32)
    step = max(1, _CHUNK // n)
    for a in range(0, xx.shape[0], step):
        part = slice(a, a + step)
        distance = np.hypot(at[:, 0, None] - xx[part], at[:, 1, None] - yy[part])
        near = np.exp(-distance / settings.seen_length_m).astype(np.float32)
        heard[:, part] = reported @ near
        scanned[part] = near.sum(axis=0)
    return heard, scanned


def _share_at_strength(mean: Float32Array, heard: Float32Array, scanned: Float32Array) -> Float32Array:
    """Probability of being reported as the expected strength tells: this level's own curve, by bins of 3 dB."""
    near = scanned > 0.7  # a scan within about one seen_length_m
    bins = np.clip(np.digitize(mean[:, near], _MEAN_BINS), 0, len(_MEAN_BINS)).ravel()
    n = len(_MEAN_BINS) + 1
    share = np.bincount(bins, (heard[:, near] / scanned[near]).ravel(), n) / np.maximum(
        np.bincount(bins, minlength=n), 1
    )
    centres = np.concatenate((_MEAN_BINS[:1] - 1.5, _MEAN_BINS + 1.5))
    curve: Float32Array = np.interp(mean, centres, share).astype(np.float32)
    return curve
