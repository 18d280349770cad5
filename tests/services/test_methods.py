"""The engine's registry decides which methods and parameters a session may name."""

from __future__ import annotations

import pytest

from app.engine.localization.registry import DEFAULT_METHOD, METHODS
from app.services.errors import InvalidError
from app.services.methods import AUTO, check_method, method_for
from app.services.places import choose_place
from tests.support.builders import World


@pytest.mark.parametrize("method", METHODS)
def test_every_method_works_with_its_defaults(method: str) -> None:
    check_method(method, {})


def test_an_unknown_method_is_answered_with_the_known_ones() -> None:
    with pytest.raises(InvalidError) as caught:
        check_method("magic", {})
    assert caught.value.field == "method"
    assert all(name in caught.value.remedy for name in METHODS)


def test_an_unknown_parameter_is_named() -> None:
    with pytest.raises(InvalidError) as caught:
        check_method(DEFAULT_METHOD, {"luck": 7})
    assert caught.value.field == "parameters.luck"
    assert DEFAULT_METHOD in caught.value.remedy


def test_auto_takes_no_parameters() -> None:
    check_method(AUTO, {})
    with pytest.raises(InvalidError) as caught:
        check_method(AUTO, {"particles": 7})
    assert caught.value.field == "parameters"


def test_auto_is_resolved_and_says_why(world: World) -> None:
    level = world.mapped_level()
    session = world.services.sessions.create(level.id, AUTO, {})
    assert (session.method, bool(session.method_reason)) == ("particle", True)
    assert world.services.sessions.get(session.id) == session
    assert world.services.sessions.create(level.id, DEFAULT_METHOD, {}).method_reason is None


@pytest.mark.parametrize(("method", "field"), [("declination_aided", "method"), ("subsequence_dtw", "method")])
def test_a_method_that_cannot_serve_is_refused(world: World, method: str, field: str) -> None:
    level = world.mapped_level()
    with world.database() as uow:
        place = choose_place(uow, level.id, None, None)
        with pytest.raises(InvalidError) as caught:
            method_for(uow, place, method, None)
    assert caught.value.field == field


def test_a_matcher_wants_one_level(world: World) -> None:
    venue_id, _ = world.venue(0, 1)
    with world.database() as uow:
        place = choose_place(uow, None, venue_id, None)
        with pytest.raises(InvalidError, match="one level"):
            method_for(uow, place, "magcom", None)
        assert method_for(uow, place, AUTO, None).name == "particle"
