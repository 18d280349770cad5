"""The Python client on a line that is cut again and again: every segment and every fix once, in order."""

from __future__ import annotations

import asyncio
import random
import threading
from collections.abc import Iterable, Iterator

import isodyn_client as isodyn
import pytest
from isodyn_client import PlanFix
from isodyn_client.stream import AsyncSegmentStream, SegmentStream

from app.cli.convert import samples_of
from tests.e2e.conftest import MakeService, Prepared
from tests.e2e.service import Service
from tests.e2e.synthetic import Walk, trip
from tests.support.cutting import CuttingRelay

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]
SEGMENT_S = 1.0
QUICK = isodyn.RetryPolicy(retries=12, base_s=0.02, max_pause_s=0.2)


@pytest.fixture(scope="module")
def walk() -> Walk:
    return trip(41, t0=1.76e9)


@pytest.fixture
def service(make_service: MakeService) -> Service:
    made = make_service()
    made.start()
    return made


@pytest.fixture
def relay(service: Service) -> Iterator[CuttingRelay]:
    """Connections that live for a handshake and a few messages."""
    rng = random.Random(3)
    with CuttingRelay(service.port, lambda: rng.randrange(1000, 40_000)) as made:
        yield made


def pieces(walk: Walk) -> list[isodyn.Samples]:
    return list(samples_of(walk.samples).split(SEGMENT_S))


def start_of(walk: Walk) -> isodyn.Prior:
    return isodyn.Prior(x=float(walk.x[0]), y=float(walk.y[0]), radius_m=3.0)


def direct(service: Service) -> isodyn.Client:
    return isodyn.Client(f"http://127.0.0.1:{service.port}", service.key)


def check(service: Service, session_id: str, told: Iterable[PlanFix], n_segments: int) -> None:
    """What was told is what is stored, and no segment was lost or counted twice."""
    told = list(told)
    with direct(service) as client:
        stored = client.positions(session_id)
        assert client.session_info(session_id).next_seq == n_segments
    assert [fix.number for fix in told] == list(range(len(stored)))
    assert [(fix.t_ms, fix.x, fix.y) for fix in told] == list(
        zip(stored.t_ms.tolist(), stored.x.tolist(), stored.y.tolist(), strict=True)
    )
    assert len(told) > n_segments // 2


def test_a_stream_loses_and_repeats_nothing(
    service: Service, prepared: Prepared, relay: CuttingRelay, walk: Walk
) -> None:
    parts = pieces(walk)
    told: list[PlanFix] = []
    with direct(service) as client, isodyn.Client(relay.url, service.key) as cut:
        session = client.create_session(prepared.level_id, prior=start_of(walk))
        with SegmentStream(cut, session.id, policy=QUICK) as stream:
            for seq, part in enumerate(parts):
                assert stream.send(part) == seq
                told += stream.received()
            told += stream.finish()
        assert stream.session is not None
        assert stream.session.status is isodyn.SessionStatus.CLOSED
    assert relay.cuts >= 5
    check(service, session.id, told, len(parts))


def test_an_awaited_stream_loses_and_repeats_nothing(
    service: Service, prepared: Prepared, relay: CuttingRelay, walk: Walk
) -> None:
    parts = pieces(walk)

    async def main(session_id: str) -> list[PlanFix]:
        async with (
            isodyn.AsyncClient(relay.url, service.key) as cut,
            AsyncSegmentStream(cut, session_id, policy=QUICK) as stream,
        ):

            async def measure() -> None:
                for seq, part in enumerate(parts):
                    assert await stream.send(part) == seq

            sending = asyncio.create_task(measure())
            told = []
            async for fix in stream:
                told.append(fix)
                if sending.done():
                    break
            await sending
            told += [fix async for fix in stream.finish()]
            return told

    with direct(service) as client:
        session = client.create_session(prepared.level_id, prior=start_of(walk))
    told = asyncio.run(main(session.id))
    assert relay.cuts >= 5
    check(service, session.id, told, len(parts))


def test_followers_miss_nothing(service: Service, prepared: Prepared, relay: CuttingRelay, walk: Walk) -> None:
    """Blocking and awaited, over the same bad line, while the session goes on."""
    parts = pieces(walk)
    told: dict[str, list[PlanFix]] = {}
    with direct(service) as client:
        session = client.open_session(prepared.level_id, prior=start_of(walk))

        def watch() -> None:
            with isodyn.Client(relay.url, service.key) as cut:
                told["blocking"] = list(cut.follow(session.id))

        async def awaited() -> list[PlanFix]:
            async with isodyn.AsyncClient(relay.url, service.key) as cut:
                return [fix async for fix in cut.follow(session.id)]

        def watch_awaited() -> None:
            told["awaited"] = asyncio.run(awaited())

        watchers = [threading.Thread(target=one) for one in (watch, watch_awaited)]
        for one in watchers:
            one.start()
        for part in parts:
            session.send(part)
        session.close()
        for one in watchers:
            one.join(120)
    for fixes in told.values():
        check(service, session.id, fixes, len(parts))
    assert set(told) == {"blocking", "awaited"}


def test_refusals_are_raised_and_leave_their_numbers_free(service: Service, prepared: Prepared, walk: Walk) -> None:
    parts = pieces(walk)
    with direct(service) as client:
        session = client.create_session(prepared.level_id, prior=start_of(walk))
        tesla = isodyn.Samples(parts[1].t_ms, parts[1].mag * 1000, parts[1].acc, parts[1].gyro)
        with SegmentStream(client, session.id) as stream:
            stream.send(parts[0])
            stream.send(tesla)
            with pytest.raises(isodyn.InvalidRequestError, match="nT"):
                for _ in stream:
                    pass
            assert stream.send(parts[1]) == 1
            assert len(list(stream.finish())) > 0
        check_seq = client.session_info(session.id).next_seq
        assert check_seq == 2
        with pytest.raises(isodyn.NotFoundError), SegmentStream(client, "ses_none"):
            pass
    stranger = isodyn.Client(f"http://127.0.0.1:{service.port}", "isk_wrong")
    with stranger, pytest.raises(isodyn.UnauthorizedError), SegmentStream(stranger, session.id):
        pass


def test_all_sessions_are_told_of(service: Service, prepared: Prepared, walk: Walk) -> None:
    with direct(service) as client:
        live = client.follow_all(level_id=prepared.level_id)
        first = next(live)
        assert isinstance(first, isodyn.Snapshot)
        with client.open_session(prepared.level_id, prior=start_of(walk)) as session:
            done = session.send(pieces(walk)[0], wait=30)
        assert done.position is not None
        found: list[isodyn.LastKnown | isodyn.SessionChange | isodyn.Snapshot] = []
        for event in live:
            found.append(event)
            if isinstance(event, isodyn.SessionChange) and event.status is isodyn.SessionStatus.CLOSED:
                break
        (fix,) = [one for one in found if isinstance(one, isodyn.LastKnown)]
        assert (fix.session_id, fix.x, fix.y) == (session.id, done.position.x, done.position.y)
