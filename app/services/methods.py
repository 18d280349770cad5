"""Checks of a method's name and parameters against the engine's registry, and the choice where none is named."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from app.engine.errors import InputError
from app.engine.localization.choice import Scale, Situation, choose
from app.engine.localization.registry import METHODS, create_tracker
from app.engine.matching import common_features
from app.engine.types import Prior
from app.services.errors import InvalidError
from app.services.places import Place
from app.services.ports import UnitOfWork
from app.services.records import LevelMap, MapInfo

AUTO = "auto"
"""Asks for a method to be chosen; the answer names it, and says why."""
MethodCheck = Callable[[str, Mapping[str, object]], None]
"""``check(method, parameters)`` raises :class:`InvalidError` for what the engine would refuse."""


@dataclass(frozen=True, slots=True)
class ChosenMethod:
    """The method of a trip; ``reason`` if it was chosen for the caller."""

    name: str
    reason: str | None = None


def check_method(method: str, parameters: Mapping[str, object]) -> None:
    """Refuse methods and parameters that the engine does not know, before anything is stored."""
    if method == AUTO:
        if parameters:
            raise InvalidError(
                "parameters",
                "are those of a method, and with auto there is none yet",
                "leave parameters out, or name the method",
            )
        return
    if method not in METHODS:
        raise InvalidError("method", f"{method!r} is unknown", f"choose {AUTO} or one of {', '.join(sorted(METHODS))}")
    try:
        create_tracker(method, parameters)
    except InputError as error:
        remedy = f"see GET /v1/methods/{method} for names, types and ranges"
        raise InvalidError(error.field, error.message, remedy) from error


def method_for(
    uow: UnitOfWork, place: Place, method: str, prior: Prior | None, *, odometry: bool = True
) -> ChosenMethod:
    """The named method if it can serve on this place, or with ``auto`` the one that suits.

    Parameters
    ----------
    uow : UnitOfWork
    place : Place
    method : str
        Known to the registry, or ``auto``.
    prior : Prior or None
    odometry : bool
        Whether steps or speed will tell the way.

    Raises
    ------
    InvalidError
        The method needs what the place or the prior lacks.
    """
    start_known = prior is not None and prior.x is not None
    if method == AUTO:
        maps = list(map(_info(uow), place.maps))
        situation = Situation(
            scale=Scale(uow.venues.get(place.venue_id).kind),
            features=common_features(*(info.features for info in maps)),
            has_routes=all(info.n_routes for info in maps),
            prior=start_known,
            odometry=odometry,
            levels=1 if place.level_id is not None else len(maps),
        )
        choice = choose(situation)
        return ChosenMethod(choice.method, choice.why)
    known = METHODS.get(method)
    if known is None:  # another registry's: it was checked against that
        return ChosenMethod(method)
    if known.kind == "matcher" and place.level_id is None:
        raise InvalidError("method", f"{method} works on one level", f"send level_id, or leave the method to {AUTO}")
    lacking = [str(info.features) for info in map(_info(uow), place.maps) if info.features not in known.features]
    if lacking:
        raise InvalidError(
            "method",
            f"{method} needs {', '.join(known.features)}, and this map has {lacking[0]}",
            "build the map with other features, or choose another method",
        )
    if known.needs_prior and not start_known:
        raise InvalidError(
            "prior", f"is missing: {method} searches about a known place", "send prior with x, y and radius_m"
        )
    if known.needs_routes and not all(info.n_routes for info in map(_info(uow), place.maps)):
        raise InvalidError(
            "method",
            f"{method} compares with survey lines, and this map has not kept any",
            "build the map anew, or choose another method",
        )
    return ChosenMethod(method)


def _info(uow: UnitOfWork) -> Callable[[LevelMap], MapInfo]:
    """Header of a trip's map."""
    return lambda one: uow.maps.get(one.map_id)
