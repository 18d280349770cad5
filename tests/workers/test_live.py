"""The hub that tells watchers of changed sessions."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from datetime import UTC, datetime
from typing import Any

import pytest

from app.services.ids import new_id
from app.services.new_jobs import new_job
from app.services.records import Job, JobKind
from app.workers.live import SessionHub

SOON, LONG = 0.01, 5.0
Scenario = Callable[[SessionHub], Coroutine[Any, Any, None]]


def run(scenario: Scenario) -> SessionHub:
    hub = SessionHub()
    asyncio.run(scenario(hub))
    return hub


def job(kind: JobKind, **subject: str | int) -> Job:
    now = datetime(2026, 1, 1, tzinfo=UTC)
    return new_job(kind, new_id("ses", now), subject, now)


def test_changes_reach_those_who_watch_the_session_or_all() -> None:
    async def scenario(hub: SessionHub) -> None:
        one, other, all_of_them = hub.watch("a"), hub.watch("b"), hub.watch()
        hub.session_changed("a")
        assert await one.wait(LONG) == {"a"}
        assert await all_of_them.wait(LONG) == {"a"}
        assert await other.wait(SOON) == frozenset()

    run(scenario)


def test_changes_before_the_wait_are_told_and_gathered() -> None:
    async def scenario(hub: SessionHub) -> None:
        watch = hub.watch()
        for session_id in ("a", "b", "a"):
            hub.session_changed(session_id)
        await asyncio.sleep(0)
        assert await watch.wait(LONG) == {"a", "b"}
        assert await watch.wait(SOON) == frozenset()

    run(scenario)


def test_any_thread_may_tell() -> None:
    async def scenario(hub: SessionHub) -> None:
        watch = hub.watch("a")
        thread = threading.Thread(target=hub.session_changed, args=("a",))
        thread.start()
        assert await watch.wait(LONG) == {"a"}
        thread.join()

    run(scenario)


@pytest.mark.parametrize("kind", [JobKind.LOCATE_SEGMENT, JobKind.CONTRIBUTE])
def test_the_end_of_a_job_changes_its_session(kind: JobKind) -> None:
    async def scenario(hub: SessionHub) -> None:
        watch = hub.watch("a")
        hub.job_queued(job(kind, session_id="a", seq=0))
        assert await watch.wait(SOON) == frozenset()
        hub.job_finished(job(kind, session_id="a", seq=0))
        assert await watch.wait(LONG) == {"a"}
        hub.job_finished(job(JobKind.BUILD_MAP, level_id="a"))
        assert await watch.wait(SOON) == frozenset()

    run(scenario)


def test_who_cancels_is_told_nothing_and_forgotten() -> None:
    async def scenario(hub: SessionHub) -> None:
        watch, all_of_them = hub.watch("a"), hub.watch()
        assert hub.watching == 2
        watch.cancel()
        all_of_them.cancel()
        watch.cancel()
        assert hub.watching == 0
        hub.session_changed("a")
        assert await watch.wait(SOON) == frozenset()

    run(scenario)


def test_closing_ends_every_watch_those_that_come_later_too() -> None:
    async def scenario(hub: SessionHub) -> None:
        watch, all_of_them = hub.watch("a"), hub.watch()
        hub.close()
        late = hub.watch("b")
        for one in (watch, all_of_them, late):
            await one.wait(LONG)
            assert one.closed
            # and does not wait again
            await asyncio.wait_for(one.wait(LONG), 1.0)

    run(scenario)


def test_a_watcher_whose_loop_is_gone_harms_nobody() -> None:
    hub = run(lambda hub: _watch(hub))
    hub.session_changed("a")
    hub.close()


async def _watch(hub: SessionHub) -> None:
    hub.watch("a")
