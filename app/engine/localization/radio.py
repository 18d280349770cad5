"""Wi-Fi and BLE scans as evidence about position and level.

A scan is judged at every node of a level's radio map: by *which* transmitters it reports (given how many) and by how
strong they are. Readings of one scan err together (the carrier's body, a crowd, a survey walk placed a metre off), so
their sum is tempered by the square root of their number; radios of one access point (addresses that differ in the last
digit) count as little more than one; and a scan soon after another counts only as far as the walker has moved since.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from hashlib import blake2b
from weakref import WeakKeyDictionary

import numpy as np

from app.engine.kernels.radio import interpolate, scan_log_likelihood
from app.engine.localization.memo import Memo
from app.engine.mapping.radio import BLE_PREFIX, Readings, merge_readings
from app.engine.types import Float32Array, Float64Array, IntArray, RadioMap, RadioScans

WIFI_SCAN_S = 1.0
BLE_SCAN_S = 2.0
"""Readings within this time are one scan. Beacons are heard one by one, so a scan of them takes longer."""
_ANCHORS = 64
"""Readings that are enough to find the device's offset."""


@dataclass(frozen=True, slots=True)
class KindModel:
    """How readings of one kind of radio are weighed; fitted on left-out survey walks.

    Attributes
    ----------
    temper : float
        A scan of ``n`` access points weighs ``temper * sqrt(n)`` times one of them.
    sibling : float
        ``k`` radios of one access point weigh ``k ** sibling`` times one radio.
    offset_sd : float, dB
        How much the device's gain, and how it is carried, shift all readings.
    most : float
        What one reading can cost at most (natural logarithm).
    """

    temper: float = 0.7
    sibling: float = 0.7
    offset_sd: float = 5.0
    most: float = 6.0


@dataclass(frozen=True, slots=True)
class RadioModel:
    """Parameters of the likelihood.

    Attributes
    ----------
    wifi, ble : KindModel
    unseen : float
        Probability of being reported where the survey never was: new shops open, phones pass.
    stranger_dbm, stranger_sd : float, dBm and dB
        Strength of transmitters that the level's map does not have (they are on another level).
    renewal_m : float, m
        A scan ``d`` metres after another counts ``1 - exp(-d / renewal_m)``.
    least_renewal : float
        What a scan at the same place counts all the same.
    company : float
        What a BLE scan counts beside a Wi-Fi scan of the same place: both err with the walker's body and the survey.
    """

    wifi: KindModel = KindModel()
    ble: KindModel = KindModel(temper=1.2)
    unseen: float = 0.006
    stranger_dbm: float = -88.0
    stranger_sd: float = 7.0
    renewal_m: float = 10.0
    least_renewal: float = 0.05
    company: float = 0.5


@dataclass(frozen=True, slots=True)
class RadioScan:
    """Readings of about one moment: ``name`` of each transmitter, ``rssi`` (k,) dBm, mean and newest time, s.

    Of one kind of radio; BLE names carry the prefix of :func:`~app.engine.mapping.radio.merge_readings`.
    """

    t: float
    newest_t: float
    name: tuple[str, ...]
    rssi: Float64Array

    @property
    def is_ble(self) -> bool:
        """Whether it is of beacons."""
        return bool(self.name) and self.name[0].startswith(BLE_PREFIX)


def group_scans(wifi: RadioScans | None, ble: RadioScans | None, *, after: float = -np.inf) -> tuple[RadioScan, ...]:
    """A segment's readings as scans, oldest first; readings not later than ``after`` are left out (seen before)."""
    scans = _scans(merge_readings(wifi, None), after, WIFI_SCAN_S)
    scans += _scans(merge_readings(None, ble), after, BLE_SCAN_S)
    return tuple(sorted(scans, key=lambda scan: scan.newest_t))


def _scans(readings: Readings, after: float, scan_s: float) -> list[RadioScan]:
    first = int(np.searchsorted(readings.t, after, side="right"))
    scans = []
    while first < len(readings):
        last = int(np.searchsorted(readings.t, readings.t[first] + scan_s, side="left"))
        t = readings.t[first:last]
        scans.append(RadioScan(float(t.mean()), float(t[-1]), readings.name[first:last], readings.rssi[first:last]))
        first = last
    return scans


@dataclass(frozen=True, slots=True)
class _Index:
    """What of a radio map is worked out once: row of each transmitter, expected number reported per node."""

    rows: Mapping[str, int]
    log_total: Mapping[bool, Float32Array]
    """For Wi-Fi (False) and BLE (True): logarithm of the sum of probabilities at each node."""


REMEMBERED = 256
"""Fields kept a map: the scans of a dozen searches, some megabytes."""
_fields = Memo[RadioMap, tuple[RadioModel, bool, bytes], Float32Array](REMEMBERED)
_indexes: WeakKeyDictionary[RadioMap, dict[float, _Index]] = WeakKeyDictionary()


def _index(radio: RadioMap, unseen: float) -> _Index:
    known = _indexes.setdefault(radio, {})
    if unseen not in known:
        ble = np.array([name.startswith(BLE_PREFIX) for name in radio.addresses], dtype=bool)
        count = np.zeros((2, *radio.seen.shape[1:]), np.float32)
        for row, kind in enumerate(ble):
            count[int(kind)] += np.maximum(radio.seen[row] / np.float32(255.0), np.float32(unseen))
        totals = {bool(kind): np.log(np.maximum(count[kind], unseen)).astype(np.float32) for kind in (0, 1)}
        known[unseen] = _Index({name: row for row, name in enumerate(radio.addresses)}, totals)
    return known[unseen]


def log_likelihood(
    radio: RadioMap,
    scan: RadioScan,
    model: RadioModel | None = None,
    *,
    vocabulary: Collection[str] | None = None,
) -> Float32Array:
    """Tempered log-likelihood of a scan at every node, shape (rows, columns), not to be written to.

    A search asks for the scans of its walk again with every segment, so the newest fields of a map are remembered.

    Parameters
    ----------
    radio : RadioMap
    scan : RadioScan
    model : RadioModel
    vocabulary : collection of str or None
        Transmitters that may count; others are ignored. With the transmitters of several levels, the values of these
        levels' maps are comparable: hearing a transmitter that another level has and this one has not tells against
        this one. None: the map's own.
    """
    model = model or RadioModel()
    index = _index(radio, model.unseen)
    names: Collection[str] = index.rows.keys() if vocabulary is None else vocabulary
    part = sorted((i for i, name in enumerate(scan.name) if name in names), key=scan.name.__getitem__)
    if not part:
        return np.zeros(radio.mean.shape[1:], np.float32)
    heard = tuple(scan.name[i] for i in part)  # by name: which of them anchor the offset shall not be the strongest
    rssi, is_ble = scan.rssi[part], scan.is_ble
    kind = model.ble if is_ble else model.wifi
    key = (model, is_ble, blake2b("\n".join(heard).encode() + rssi.tobytes(), digest_size=16).digest())
    return _fields.get(
        radio, key, lambda: _kind_log_likelihood(radio, index, heard, rssi, model, kind, index.log_total[is_ble])
    )


def _kind_log_likelihood(
    radio: RadioMap,
    index: _Index,
    names: tuple[str, ...],
    rssi: Float64Array,
    model: RadioModel,
    kind: KindModel,
    log_total: Float32Array,
) -> Float32Array:
    weight, points = _weights(names, kind.sibling)
    rows = np.array([index.rows.get(name, -1) for name in names], dtype=np.int64)
    known = rows >= 0
    nodes = radio.mean.shape[1] * radio.mean.shape[2]
    value = np.empty(nodes, np.float32)
    scan_log_likelihood(
        rows[known], rssi[known], weight[known],
        *(layer.reshape(-1, nodes) for layer in (radio.mean, radio.sd, radio.seen)),
        np.log(np.maximum(np.arange(256) / 255.0, model.unseen)).astype(np.float32),
        np.log(np.maximum(0.1 * np.arange(256), 0.1)).astype(np.float32),
        kind.offset_sd**2, kind.most, _ANCHORS, np.empty((3, nodes), np.float32), value,
    )  # fmt: skip
    value = value.reshape(log_total.shape) - float(weight.sum()) * log_total
    strange = (rssi[~known] - model.stranger_dbm) / model.stranger_sd
    cost = np.log(model.unseen) - np.log(model.stranger_sd) - 0.5 * strange**2 / (1.0 + 0.5 * strange**2 / kind.most)
    value += float(weight[~known] @ cost)
    tempered: Float32Array = value * np.float32(kind.temper / np.sqrt(points))
    tempered.setflags(write=False)  # shared by all who ask
    return tempered


def _weights(names: tuple[str, ...], sibling: float) -> tuple[Float64Array, int]:
    """Weight of each reading, and how many access points there are."""
    _, point, count = np.unique([access_point(name) for name in names], return_inverse=True, return_counts=True)
    return count[point.ravel()].astype(np.float64) ** (sibling - 1.0), len(count)


def access_point(name: str) -> str:
    """What the radios of one access point share: a Wi-Fi address without its last digit; a beacon is alone."""
    return name if name.startswith(BLE_PREFIX) else name[:-1]


def weights_at(log_grid: Float32Array, radio: RadioMap, x: Float64Array, y: Float64Array) -> Float64Array:
    """Bilinear look-up of log weights at positions; beyond the grid its edge holds. Shape of ``x``."""
    weights = np.empty(x.shape)
    x, y = (np.ascontiguousarray(v, np.float64) for v in (x, y))
    interpolate(log_grid, radio.x0, radio.y0, radio.cell_m, x.ravel(), y.ravel(), weights.reshape(-1))
    return weights


def sample_positions(
    log_grid: Float32Array, radio: RadioMap, n: int, rng: np.random.Generator
) -> tuple[Float64Array, Float64Array]:
    """Draw ``n`` positions from the grid's weights, uniform within a node's cell (systematic: few draws spread well).

    Returns
    -------
    x, y : arrays, shape (n,), m
    """
    share = np.exp(log_grid.astype(np.float64).ravel() - float(log_grid.max()))
    cumulative = np.cumsum(share / share.sum())
    node = np.searchsorted(cumulative, (np.arange(n) + rng.random()) / n)
    node = np.minimum(node, share.shape[0] - 1)
    row, column = np.divmod(node, log_grid.shape[1])
    x = radio.x0 + radio.cell_m * (column + rng.uniform(-0.5, 0.5, n))
    y = radio.y0 + radio.cell_m * (row + rng.uniform(-0.5, 0.5, n))
    return x, y


@dataclass(frozen=True, slots=True)
class RadioField:
    """Log weights of one scan over the levels that have a radio map.

    Attributes
    ----------
    t : float, s
        Mean time of the readings: the weights are about where the walker was *then*.
    log : mapping of level id to array (rows, columns)
    radio : mapping of level id to RadioMap
    """

    t: float
    log: Mapping[str, Float32Array]
    radio: Mapping[str, RadioMap]

    def log_weights(self, level_id: str, x: Float64Array, y: Float64Array) -> Float64Array:
        """Log weights of positions on a level; on a level without radio map, the mean evidence of the others."""
        if level_id not in self.log:
            return np.full(x.shape, _mean_log(np.array(list(self.level_evidence().values()))))
        return weights_at(self.log[level_id], self.radio[level_id], x, y)

    def level_evidence(self) -> dict[str, float]:
        """Logarithm of the mean likelihood over each level's grid: what the scan says about the level alone."""
        return {level_id: level_evidence(grid) for level_id, grid in self.log.items()}

    def sample(self, n: int, rng: np.random.Generator) -> tuple[tuple[str, ...], IntArray, Float64Array, Float64Array]:
        """Draw levels and positions.

        Returns
        -------
        levels : tuple of level ids
        level : array, shape (n,)
            Number of each draw's level in ``levels``.
        x, y : arrays, shape (n,), m
        """
        levels = tuple(self.log)
        evidence = np.array([level_evidence(self.log[level_id]) for level_id in levels])
        cumulative = np.cumsum(np.exp(evidence - evidence.max()))
        edges = np.searchsorted((np.arange(n) + rng.random()) / n, cumulative / cumulative[-1])
        edges[-1] = n
        count = np.diff(edges, prepend=0)
        drawn = [
            sample_positions(self.log[level_id], self.radio[level_id], int(k), rng)
            for level_id, k in zip(levels, count, strict=True)
        ]
        x, y = (np.concatenate([place[axis] for place in drawn]) for axis in (0, 1))
        return levels, np.repeat(np.arange(len(levels)), count), x, y


def level_evidence(log_grid: Float32Array) -> float:
    """Logarithm of the mean likelihood over a level's nodes; comparable between levels with one vocabulary."""
    return _mean_log(log_grid.astype(np.float64).ravel())


def _mean_log(values: Float64Array) -> float:
    top = float(values.max())
    return top + float(np.log(np.exp(values - top).mean()))


@dataclass(frozen=True, slots=True)
class RadioMemory:
    """What a session keeps: time of the newest reading used (s), the way walked by the last Wi-Fi and BLE scan (m)."""

    last_t: float = -np.inf
    wifi_travelled_m: float = -np.inf
    ble_travelled_m: float = -np.inf


class RadioAid:
    """Scans of a session, turned into log weights one after the other.

    Holds maps and parameters only; what it has used is in the :class:`RadioMemory` that goes in and comes out.
    """

    def __init__(self, maps: Mapping[str, RadioMap], model: RadioModel | None = None) -> None:
        self.maps = maps
        self.model = model or RadioModel()
        self._vocabulary = frozenset(name for radio in maps.values() for name in radio.addresses)

    def scans(self, memory: RadioMemory, wifi: RadioScans | None, ble: RadioScans | None) -> tuple[RadioScan, ...]:
        """New scans among a segment's readings, oldest first."""
        return group_scans(wifi, ble, after=memory.last_t)

    def field(self, memory: RadioMemory, scan: RadioScan, travelled_m: float) -> tuple[RadioMemory, RadioField | None]:
        """Log weights of a scan, ``travelled_m`` metres into the session.

        None if it reports nothing that a map knows.
        """
        newest = replace(memory, last_t=max(memory.last_t, scan.newest_t))
        if not self._vocabulary.intersection(scan.name):
            return newest, None
        share = np.float32(self._share(memory, scan, travelled_m))
        log = {
            level_id: share * log_likelihood(radio, scan, self.model, vocabulary=self._vocabulary)
            for level_id, radio in self.maps.items()
        }
        if scan.is_ble:
            return replace(newest, ble_travelled_m=travelled_m), RadioField(scan.t, log, self.maps)
        return replace(newest, wifi_travelled_m=travelled_m), RadioField(scan.t, log, self.maps)

    def _share(self, memory: RadioMemory, scan: RadioScan, travelled_m: float) -> float:
        """What of a scan is new: as far as the walker has moved since the last one of its kind, and of Wi-Fi."""
        if not scan.is_ble:
            return max(self._renewed(travelled_m - memory.wifi_travelled_m), self.model.least_renewal)
        alone = self._renewed(travelled_m - memory.wifi_travelled_m)
        own = max(self._renewed(travelled_m - memory.ble_travelled_m), self.model.least_renewal)
        return own * (self.model.company + (1.0 - self.model.company) * alone)

    def _renewed(self, walked_m: float) -> float:
        return 1.0 - float(np.exp(-max(walked_m, 0.0) / self.model.renewal_m))
