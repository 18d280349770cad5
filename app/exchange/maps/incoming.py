"""From the rasters of a file to a map: lattice, channels, units, what is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from app.engine.errors import InputError
from app.engine.types import BoolArray, FeatureSet, Float32Array, Float64Array, GridMap, MapBuildSettings
from app.exchange.maps.document import FEATURES_OF, OBSTACLE, SUPPORT, Rasters, Value

DEFAULT_SD = 3.0
"""uT: standard deviation of a map whose file tells none. Between walks over one spot the field of surveys by phone
differs by 2 to 4 uT after their offsets are removed."""
_DEFAULT_MAPPED_M = MapBuildSettings().mapped_m
_MAX_NODES = 16_000_000
_MAX_FIELD = 2000.0
"""uT: as for samples; more is another unit."""
_SUPPORT_CAP_M = 50.0
_EVEN = 1e-3
"""Nodes may be off the even lattice by this share of the spacing: text formats round."""
_MICROTESLA = frozenset({"ut", "microtesla", "microteslas", "µt", "μt", "1e-6 t"})
_NANOTESLA = frozenset({"nt", "nanotesla", "nanoteslas", "gamma", "1e-9 t"})

_NAMES: Mapping[str, Sequence[str]] = {
    "x": ("x", "bx", "b_x", "mx", "east", "be"),
    "y": ("y", "by", "b_y", "my", "north", "bn"),
    "z": ("z", "bz", "b_z", "mz", "up", "bu"),
    "h": ("h", "bh", "b_h", "horizontal"),
    "v": ("v", "bv", "b_v", "vertical"),
    "total": ("total", "f", "b", "tmi", "magnitude", "intensity", "total_field", "field", "norm"),
}
_MEANS = {alias: name for name, aliases in _NAMES.items() for plain in aliases for alias in (plain, f"mean_{plain}")}
_SDS = {
    alias: name
    for name, aliases in _NAMES.items()
    for plain in aliases
    for word in ("sd", "std", "sigma", "stdev")
    for alias in (f"{word}_{plain}", f"{plain}_{word}")
}
_LONE_SDS = frozenset({"sd", "std", "sigma", "stdev"})
"""Names of a standard deviation that belongs to the only channel there is."""


@dataclass(frozen=True, slots=True)
class ImportChoices:
    """What the sender says of a file, where the file itself does not.

    Attributes
    ----------
    channel : str or None
        What the only layer of a file is: ``x``, ``y``, ``z``, ``h``, ``v`` or ``total``.
    unit : str or None
        ``uT`` or ``nT``; wins over the file's.
    sd : float or None, uT
        Standard deviation of the map, where the file has no layer of it. None: :data:`DEFAULT_SD`.
    """

    channel: str | None = None
    unit: str | None = None
    sd: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ImportedMap:
    """A map that was read.

    Attributes
    ----------
    grid : GridMap
    field_sd : tuple of float, uT
    length_scale_m : float
    attributes : mapping
        Of the file.
    assumed : tuple of str
        What the file did not tell and was taken instead, in words.
    """

    grid: GridMap
    field_sd: tuple[float, ...]
    length_scale_m: float
    attributes: Mapping[str, Value]
    assumed: tuple[str, ...]


def map_of(rasters: Rasters, level_id: str, choices: ImportChoices) -> ImportedMap:
    """Make a map of rasters.

    Raises
    ------
    InputError
        Uneven or oblong lattice, unknown or incomplete channels, unknown unit, values that are infinite or no field's.
    """
    assumed: list[str] = []
    cell_m = _cell(rasters)
    means, sds = _sorted_layers(rasters, choices)
    features = _features(means)
    mean = _stack(rasters, [means[name] for name in features.channels], choices, assumed)
    known: BoolArray = np.asarray(np.isfinite(mean).all(axis=0))
    if not known.any():
        raise InputError("file", "has no node with a value in every channel; send a grid with values")
    sd = _sd(rasters, [sds.get(name) for name in features.channels], choices, assumed, known)
    level = mean[:, known].astype(np.float64).mean(axis=1)
    field_sd = _told(rasters, "field_sd", mean[:, known].astype(np.float64).std(axis=1), assumed=None)
    if not known.all():
        # as everywhere far from samples: the level's mean, as uncertain as the field varies
        mean = np.where(known, mean, level.astype(np.float32)[:, None, None])
        sd = np.where(known, sd, np.maximum(field_sd, sd[:, known].max(axis=1)).astype(np.float32)[:, None, None])
    mapped_m = _positive(rasters, "mapped_m") or _DEFAULT_MAPPED_M
    grid = GridMap(
        level_id=level_id,
        features=features,
        x0=_origin(rasters, "x0", rasters.x, cell_m),
        y0=_origin(rasters, "y0", rasters.y, cell_m),
        cell_m=cell_m,
        mean=mean,
        sd=sd,
        support=_support(rasters, known, cell_m, mapped_m, assumed),
        mapped_m=mapped_m,
        noise_sd=_told(rasters, "noise_sd", np.median(sd[:, known], axis=1), assumed=assumed),
        obstacle=_depth(rasters),
    )
    length = _positive(rasters, "length_scale_m") or _length_scale(grid, known, np.array(field_sd))
    return ImportedMap(grid, field_sd, length, rasters.attributes, tuple(assumed))


def _cell(rasters: Rasters) -> float:
    """Spacing of the lattice, m; the file's own word where it agrees, so that nothing is lost to rounding."""
    for name in ("x", "y"):
        _check_axis(name, getattr(rasters, name))
    if len(rasters.x) * len(rasters.y) > _MAX_NODES:
        raise InputError("file", f"has more than {_MAX_NODES} nodes; send a coarser or a smaller grid")
    steps = [float(axis[-1] - axis[0]) / (len(axis) - 1) for axis in (rasters.x, rasters.y)]
    if abs(steps[0] - steps[1]) > _EVEN * min(steps):
        raise InputError("file", f"has cells of {steps[0]:g} x {steps[1]:g} m; resample it to square cells")
    told = _positive(rasters, "cell_m")
    cell = told if told is not None and abs(told - steps[0]) <= _EVEN * told else steps[0]
    if not 0.01 <= cell <= 1000.0:
        raise InputError("file", f"has cells of {cell:g} m; send a grid in metres of the level frame")
    return cell


def _check_axis(name: str, axis: Float64Array) -> None:
    if len(axis) < 2:
        raise InputError(name, f"has {len(axis)} nodes; send a grid of at least 2 x 2")
    if not np.isfinite(axis).all():
        raise InputError(name, "is not finite; send coordinates in metres")
    steps = np.diff(axis)
    mean = float(axis[-1] - axis[0]) / (len(axis) - 1)
    if mean <= 0 or np.abs(axis - (axis[0] + mean * np.arange(len(axis)))).max() > _EVEN * mean:
        worst = int(np.abs(steps - mean).argmax())
        raise InputError(
            name, f"is not evenly spaced (step {worst} is {steps[worst]:g}); resample the grid to an even lattice"
        )


def _origin(rasters: Rasters, name: str, axis: Float64Array, cell_m: float) -> float:
    told = rasters.attributes.get(name)
    return told if isinstance(told, float) and abs(told - axis[0]) <= _EVEN * cell_m else float(axis[0])


def _sorted_layers(rasters: Rasters, choices: ImportChoices) -> tuple[dict[str, str], dict[str, str]]:
    """Names of the layers that hold mean and standard deviation, by channel."""
    means: dict[str, str] = {}
    sds: dict[str, str] = {}
    lone_sd: str | None = None
    unknown: list[str] = []
    for layer in rasters.layers:
        plain = layer.strip().lower()
        if plain in _LONE_SDS:
            lone_sd = layer
        elif (target := _SDS.get(plain)) is not None:
            _put(sds, target, layer)
        elif choices.channel is None and (target := _MEANS.get(plain)) is not None:
            _put(means, target, layer)
        elif plain not in {SUPPORT, OBSTACLE}:
            unknown.append(layer)
    if choices.channel is not None:
        if len(unknown) != 1:
            raise InputError("channel", f"can name one layer; the file has {len(unknown)}: {_listed(unknown)}")
        means = {choices.channel: unknown[0]}
    elif unknown and not means:
        raise InputError(
            "file", f"has layers of unknown meaning ({_listed(unknown)}); say which channel it is: channel="
        )
    if lone_sd is not None and len(means) == 1:
        sds.setdefault(next(iter(means)), lone_sd)
    return means, sds


def _put(table: dict[str, str], channel: str, layer: str) -> None:
    if channel in table:
        raise InputError("file", f"has {table[channel]!r} and {layer!r} for channel {channel}; send one of them")
    table[channel] = layer


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(repr(name[:40]) for name in names[:5])
    return shown if len(names) <= 5 else f"{shown} and {len(names) - 5} more"


def _features(means: Mapping[str, str]) -> FeatureSet:
    features = FEATURES_OF.get(frozenset(means))
    if features is None:
        sets = "; ".join(f"{one.value}: {', '.join(one.channels)}" for one in FeatureSet)
        found = ", ".join(sorted(means)) or "none"
        raise InputError("file", f"has the channels {found}; send those of one feature set ({sets})")
    return features


def _stack(rasters: Rasters, names: Sequence[str], choices: ImportChoices, assumed: list[str]) -> Float32Array:
    """Means in uT, shape (channels, rows, columns)."""
    parts = [_microtesla(rasters, name, choices, assumed) for name in names]
    stack = np.stack(parts)
    if np.isinf(stack).any():
        raise InputError("file", "has infinite values; send NaN where there is no value")
    norm = (
        float(np.sqrt(np.nanmedian((stack.astype(np.float64) ** 2).sum(axis=0)))) if np.isfinite(stack).any() else 0.0
    )
    if norm > _MAX_FIELD:
        raise InputError("file", f"has a field of {norm:.4g} uT (median): looks like nT; say so: unit=nT")
    if np.nanmax(np.abs(stack), initial=0.0) > _MAX_FIELD:
        raise InputError("file", f"has values beyond {_MAX_FIELD:g} uT; take out what no field is, or name the unit")
    return stack


def _microtesla(rasters: Rasters, name: str, choices: ImportChoices, assumed: list[str]) -> Float32Array:
    values = rasters.layers[name]
    unit = (choices.unit or rasters.units.get(name, "")).strip().lower()
    if unit in _NANOTESLA:
        return _single(values.astype(np.float64) * 1e-3)
    if unit not in _MICROTESLA:
        if unit:
            raise InputError(name, f"is in {unit[:20]!r}; send uT or nT, or say which it is: unit=")
        words = "no unit is given: taken as uT"
        if words not in assumed:
            assumed.append(words)
    return _single(values)


def _single(values: Float64Array | Float32Array) -> Float32Array:
    """As float32; what is beyond becomes infinite, and is refused as such."""
    with np.errstate(over="ignore"):
        single: Float32Array = values.astype(np.float32)
    return single


def _sd(
    rasters: Rasters, names: Sequence[str | None], choices: ImportChoices, assumed: list[str], known: BoolArray
) -> Float32Array:
    if any(name is None for name in names):
        value = DEFAULT_SD if choices.sd is None else choices.sd
        if choices.sd is None:
            assumed.append(f"no standard deviation is given: taken as {DEFAULT_SD:g} uT everywhere")
        return np.full((len(names), *known.shape), value, np.float32)
    sd = np.stack([_microtesla(rasters, name, choices, assumed) for name in names if name is not None])
    if not (np.isfinite(sd[:, known]).all() and (sd[:, known] >= 0).all()):
        raise InputError(
            "sd", "is missing, infinite or negative where the mean has a value; send it for all these nodes"
        )
    return sd


def _told(
    rasters: Rasters, name: str, otherwise: Float64Array | Float32Array, *, assumed: list[str] | None
) -> tuple[float, ...]:
    """A number per channel of the file's attributes, else what the values themselves say."""
    told = rasters.attributes.get(name)
    values = told if isinstance(told, tuple) else (told,) if isinstance(told, float) else ()
    if len(values) == len(otherwise) and all(np.isfinite(one) and one >= 0 for one in values):
        return tuple(float(one) for one in values)
    if assumed is not None:
        assumed.append("no repeatability (noise_sd) is given: taken as the median standard deviation of the map")
    return tuple(float(one) for one in otherwise)


def _positive(rasters: Rasters, name: str) -> float | None:
    told = rasters.attributes.get(name)
    return told if isinstance(told, float) and np.isfinite(told) and told > 0 else None


def _plain_layer(rasters: Rasters, name: str) -> Float32Array | None:
    values = rasters.layers.get(name)
    if values is None:
        return None
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise InputError(name, "is not finite or negative; send metres, 0 or more")
    return _single(values)


def _depth(rasters: Rasters) -> Float32Array | None:
    return _plain_layer(rasters, OBSTACLE)


def _support(rasters: Rasters, known: BoolArray, cell_m: float, mapped_m: float, assumed: list[str]) -> Float32Array:
    given = _plain_layer(rasters, SUPPORT)
    if given is not None and known.all():
        return given
    if given is None:
        assumed.append("no support is given: every node with a value counts as mapped")
        given = np.zeros(known.shape, np.float32)
    # a node without a value is unmapped however near its neighbours are
    away = np.maximum(distance_transform_edt(~known) * cell_m, mapped_m + cell_m)
    return np.where(known, given, np.minimum(np.maximum(away, given), _SUPPORT_CAP_M + mapped_m)).astype(np.float32)


def _length_scale(grid: GridMap, known: BoolArray, field_sd: Float64Array) -> float:
    """Length of a Matern 3/2 field with this variance and these gradients, m.

    The correlation of Matern 3/2 is ``1 - 3 r^2 / (2 l^2)`` near 0, so a slope has variance ``3 s^2 / l^2`` per axis.
    """
    slopes = [
        np.diff(grid.mean.astype(np.float64), axis=axis)[:, both] / grid.cell_m
        for axis, both in ((1, known[1:] & known[:-1]), (2, known[:, 1:] & known[:, :-1]))
    ]
    variance = float(np.concatenate([one.ravel() ** 2 for one in slopes]).mean()) if known.sum() > 1 else 0.0
    if not variance > 0:
        return max(grid.shape) * grid.cell_m
    return float(np.sqrt(3.0 * (field_sd**2).mean() / variance))
