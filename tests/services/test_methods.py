"""The engine's registry decides which methods and parameters a session may name."""

from __future__ import annotations

import pytest

from app.engine.localization.registry import DEFAULT_METHOD, METHODS
from app.services.errors import InvalidError
from app.services.methods import check_method


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
