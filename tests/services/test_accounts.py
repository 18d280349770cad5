from __future__ import annotations

import re
from datetime import timedelta
from pathlib import Path

import pytest

from app.services.accounts import hash_secret
from app.services.errors import NotFoundError
from app.services.records import Scope
from tests.support.builders import World


def test_a_secret_opens_its_key_only(world: World) -> None:
    accounts = world.services.accounts
    key, secret = accounts.create_key("phone", {Scope.LOCATE})
    other, _ = accounts.create_key("surveyor", {Scope.SURVEY, Scope.LOCATE})
    assert re.fullmatch(rf"isk_{key.id[-14:]}_[\w-]{{32}}", secret)
    found = accounts.verify(secret)
    assert found is not None
    assert (found.id, found.scopes) == (key.id, frozenset({Scope.LOCATE}))
    for wrong in ("", secret[:-1], secret + "x", secret.upper(), key.id, hash_secret(secret)):
        assert accounts.verify(wrong) is None
    assert [listed.id for listed in accounts.list().items] == [other.id, key.id]


def test_no_secret_is_stored(world: World, tmp_path: Path) -> None:
    _, secret = world.services.accounts.create_key("phone", {Scope.LOCATE})
    admin = world.services.accounts.ensure_admin_key()
    assert admin is None
    world.close()
    stored = b"".join(path.read_bytes() for path in tmp_path.glob("isodyn.db*"))
    assert secret.encode() not in stored
    assert secret[-20:].encode() not in stored
    assert hash_secret(secret).encode() in stored


def test_a_revoked_key_is_useless_at_once(world: World) -> None:
    accounts = world.services.accounts
    key, secret = accounts.create_key("phone", {Scope.LOCATE})
    assert accounts.verify(secret) is not None
    revoked = accounts.revoke(key.id)
    assert revoked.revoked_at is not None
    assert accounts.verify(secret) is None
    assert accounts.revoke(key.id) == revoked
    with pytest.raises(NotFoundError):
        accounts.revoke("key_none")


def test_use_is_noted_once_a_minute(world: World) -> None:
    accounts = world.services.accounts
    key, secret = accounts.create_key("phone", {Scope.LOCATE})
    accounts.verify(secret)
    first = accounts.get(key.id).last_used_at
    assert first is not None
    accounts.verify(secret)
    assert accounts.get(key.id).last_used_at == first
    world.clock.now += timedelta(minutes=1)
    accounts.verify(secret)
    assert accounts.get(key.id).last_used_at == world.clock.now


def test_the_admin_key_is_made_at_the_first_start_only(tmp_path: Path) -> None:
    first = World.at(tmp_path)
    secret = first.services.accounts.ensure_admin_key()
    assert secret is not None
    assert first.services.accounts.ensure_admin_key() is None
    first.close()
    second = World.at(tmp_path)
    assert second.services.accounts.ensure_admin_key() is None
    key = second.services.accounts.verify(secret)
    assert key is not None
    assert key.scopes == {Scope.ADMIN}
    second.services.accounts.revoke(key.id)
    assert second.services.accounts.ensure_admin_key() is None
    second.close()
