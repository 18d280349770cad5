"""All methods, by name. One table feeds the API, the command line, the contract tests and the documents."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Literal

from app.engine.errors import InputError
from app.engine.localization.dead_reckoning import DeadReckoningParameters, DeadReckoningTracker
from app.engine.localization.matched import MatcherTracker
from app.engine.localization.particle import ParticleParameters, ParticleTracker
from app.engine.matching import MATCHERS, Bound, MatcherEntry
from app.engine.types import FeatureSet, Tracker

DEFAULT_METHOD = "particle"


@dataclass(frozen=True, slots=True)
class Method:
    """A method and what it can do.

    ``parameters`` is a frozen dataclass with defaults; ``bounds`` holds the range of each numeric one. ``needs_prior``:
    it can only search about a known place; ``needs_routes``: it compares with the lines that a map was surveyed along;
    ``scales``: kinds of venue that it suits.
    """

    name: str
    summary: str
    reference: str
    kind: Literal["tracker", "matcher"]
    features: tuple[FeatureSet, ...]
    needs_heading: bool
    needs_odometry: bool
    dimensions: int
    parameters: type
    bounds: Mapping[str, Bound]
    create: Callable[[Any], Tracker]
    needs_prior: bool = False
    needs_routes: bool = False
    scales: tuple[str, ...] = ("indoor", "route", "area")


_TRACKERS = (
    Method(
        name="particle",
        summary=(
            "Particle filter over steps with marginalized magnetometer offset, whitened residuals and the map's own "
            "standard deviation."
        ),
        reference="Xie et al. 2014, doi:10.1145/2632048.2632057; Schon et al. 2005, doi:10.1109/TSP.2005.849151",
        kind="tracker",
        features=(FeatureSet.VECTOR, FeatureSet.HV, FeatureSet.TOTAL),
        needs_heading=False,
        needs_odometry=False,
        dimensions=2,
        scales=("indoor",),
        parameters=ParticleParameters,
        bounds=MappingProxyType({"particles": Bound(100, 20_000), "cold_particles": Bound(100, 120_000)}),
        create=ParticleTracker,
    ),
    Method(
        name="dead_reckoning",
        summary="Steps and gyroscope alone: the baseline, without the map.",
        reference="Weinberg, Analog Devices application note AN-602, 2002",
        kind="tracker",
        features=(FeatureSet.VECTOR, FeatureSet.HV, FeatureSet.TOTAL),
        needs_heading=False,
        needs_odometry=False,
        dimensions=2,
        scales=("indoor", "route"),
        parameters=DeadReckoningParameters,
        bounds=MappingProxyType({"stride_constant": Bound(0.3, 1.1)}),
        create=DeadReckoningTracker,
    ),
)


def _served(entry: MatcherEntry) -> Method:
    """A matcher as a method of sessions."""

    def create(parameters: Any) -> Tracker:
        return MatcherTracker(
            entry.name,
            entry.create(parameters),
            needs_routes=entry.needs_routes,
            needs_region=entry.needs_region,
            needs_odometry=entry.needs_odometry,
        )

    return Method(
        name=entry.name,
        summary=entry.summary,
        reference=entry.reference,
        kind="matcher",
        features=entry.features,
        needs_heading=entry.needs_heading,
        needs_odometry=entry.needs_odometry,
        dimensions=entry.dimensions,
        parameters=entry.parameters,
        bounds=entry.bounds,
        create=create,
        needs_prior=entry.needs_region,
        needs_routes=entry.needs_routes,
        scales=entry.scales,
    )


METHODS: Mapping[str, Method] = MappingProxyType(
    {method.name: method for method in (*_TRACKERS, *map(_served, MATCHERS.values()))}
)


def create_tracker(name: str, parameters: Mapping[str, object] | None = None) -> Tracker:
    """Tracker of a method with these parameters; the rest keep their defaults.

    Raises
    ------
    InputError
        Unknown method (field ``method``), unknown parameter, wrong type or out of range (field
        ``parameters.<name>``).
    """
    method = METHODS.get(name)
    if method is None:
        raise InputError("method", f"{name!r} is unknown; one of {', '.join(METHODS)}")
    known = {f.name: f.default for f in fields(method.parameters)}
    values = {}
    for key, value in (parameters or {}).items():
        if key not in known:
            raise InputError(f"parameters.{key}", f"unknown; {name} has {', '.join(known)}")
        values[key] = _coerce(key, value, known[key], method.bounds.get(key))
    return method.create(method.parameters(**values))


def _coerce(key: str, value: object, default: object, bound: Bound | None) -> object:
    """``value`` in the type of ``default``."""
    field = f"parameters.{key}"
    if isinstance(default, StrEnum):
        choices = [str(member) for member in type(default)]
        if value not in choices:
            raise InputError(field, f"must be one of {', '.join(choices)}")
        return type(default)(value)
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InputError(field, "must be true or false")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(field, "must be a number")
    if not math.isfinite(value) or (isinstance(default, int) and value != int(value)):
        raise InputError(field, "must be a whole number" if isinstance(default, int) else "must be finite")
    if bound is not None and not bound.low <= value <= bound.high:
        raise InputError(field, f"must lie between {bound.low:g} and {bound.high:g}")
    return int(value) if isinstance(default, int) else float(value)
