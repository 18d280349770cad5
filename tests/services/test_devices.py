from __future__ import annotations

from tests.support.builders import World


def test_devices_are_created_and_listed_newest_first(world: World) -> None:
    devices = world.services.devices
    one, other = devices.create("first", "Pixel 9"), devices.create("second")
    assert devices.get(one.id) == one
    assert devices.list().items == (other, one)
    page = devices.list(limit=1)
    assert devices.list(page.next_cursor, 1).items == (one,)
