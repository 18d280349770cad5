"""A phone at the door of a service without HTTP: its messages in, and what became of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.types import ImuSamples, Prior
from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.sensor_logger import read_message
from app.services.ingest.records import (
    BuildOnArrival,
    Incoming,
    IngestApp,
    NewToken,
    Purpose,
    Received,
    RecordingInfo,
)
from app.services.records import Level, Scope
from tests.support.builders import World

COLUMNS = ("t", "mag", "acc", "gyro")


def new_token(
    device_id: str,
    level_id: str | None,
    *,
    purpose: Purpose = Purpose.LOCATE,
    venue_id: str | None = None,
    frame: PhoneFrame = PhoneFrame.ANDROID,
    prior: Prior | None = None,
    survey_id: str | None = None,
    build: BuildOnArrival = BuildOnArrival.PUBLISH,
    route: Sequence[str] = (),
) -> NewToken:
    """What a token needs, plain unless said otherwise."""
    return NewToken(
        name="phone",
        app=IngestApp.SENSOR_LOGGER,
        purpose=purpose,
        device_id=device_id,
        venue_id=venue_id,
        level_id=level_id,
        frame=frame,
        prior=prior,
        contribute=False,
        survey_id=survey_id,
        build=build,
        route=tuple(route),
    )


def key_of(world: World) -> str:
    """Id of a key that makes tokens."""
    known = world.services.accounts.list().items
    return known[0].id if known else world.services.accounts.create_key("maker", {Scope.ADMIN})[0].id


@dataclass(repr=False)
class Pusher:
    """A phone with a token of its own on a level."""

    world: World
    level: Level
    secret: str
    token_id: str

    @classmethod
    def at(cls, world: World, level: Level | None = None, **said: object) -> Pusher:
        """A new phone; on a new level with a map unless one is named."""
        level = world.mapped_level() if level is None else level
        device = world.services.devices.create("phone", "Pixel 6a")
        made = world.services.ingest_tokens.create(
            new_token(device.id, level.id, **said),  # type: ignore[arg-type]
            key_of(world),
        )
        return cls(world, level, made.secret, made.token.id)

    def push(self, body: bytes) -> Received:
        """One message of Sensor Logger."""
        message = read_message(body)
        name = f"{message.device_id}/{message.session_id}"
        return self.world.services.recordings.receive(self.secret, Incoming(name, message.message_id, message.readings))

    def push_all(self, bodies: Iterable[bytes]) -> list[Received]:
        return [self.push(body) for body in bodies]

    def recordings(self) -> list[RecordingInfo]:
        """Newest first."""
        return list(self.world.services.recordings.list(token_id=self.token_id).items)

    def recording(self) -> RecordingInfo:
        """The only one."""
        (found,) = self.recordings()
        return found

    def close(self) -> RecordingInfo:
        """End the newest recording."""
        return self.world.services.recordings.close(self.recordings()[0].id)

    def samples(self, session_id: str | None = None) -> ImuSamples:
        """All samples of a session (of the only recording's), in the order of its segments."""
        session_id = session_id or self.recording().session_id or ""
        with self.world.database() as uow:
            n = uow.sessions.get(session_id).next_seq
            parts = [uow.sessions.load_segment(session_id, seq).samples for seq in range(n)]
        return ImuSamples(*(np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS))


def same(one: ImuSamples, other: ImuSamples) -> bool:
    """Whether two recordings agree to the precision of float32."""
    return np.array_equal(one.t, other.t) and all(
        np.allclose(getattr(one, name), getattr(other, name), atol=1e-5, rtol=1e-6) for name in COLUMNS[1:]
    )
