from __future__ import annotations

import pytest

from app.services.errors import ConflictError
from tests.support.builders import World


def test_a_repeated_request_finds_what_the_first_created(world: World) -> None:
    idempotency = world.services.idempotency
    assert idempotency.replay("key_1", "abc", "h1") is None
    idempotency.remember("key_1", "abc", "h1", "ven_1")
    assert idempotency.replay("key_1", "abc", "h1") == "ven_1"
    assert idempotency.replay("key_2", "abc", "h1") is None
    with pytest.raises(ConflictError, match="another request"):
        idempotency.replay("key_1", "abc", "h2")
