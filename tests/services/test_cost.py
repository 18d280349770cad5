"""What a segment costs the service beside its location: CPU time, so that a busy machine does not fail the test."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from app.services.records import JobKind
from tests.support.builders import World, locate_result, new_segment

T = TypeVar("T")

N_SESSIONS = 4
N_SEGMENTS = 20
ACCEPT_MS = 3.0
ROUND_MS = 6.0


def _timed(costs: list[float], call: Callable[[], T]) -> T:
    start = time.thread_time()
    result = call()
    costs.append((time.thread_time() - start) * 1000)
    return result


def test_a_segment_costs_little(world: World) -> None:
    level = world.mapped_level()
    session_ids = [world.session(level.id).id for _ in range(N_SESSIONS)]
    result = locate_result(level_id=level.id, n_fixes=10, payload=bytes(64_000))
    processing, accept = world.services.processing, world.services.sessions.accept
    accepts: list[float] = []
    rounds: list[float] = []
    for seq in range(N_SEGMENTS):
        new = new_segment(seq)
        for session_id in session_ids:
            _timed(accepts, partial(accept, session_id, new))
        for _ in session_ids:
            (job,) = _timed(rounds, lambda: processing.claim(1, JobKind.LOCATE_SEGMENT))
            _timed(rounds, partial(processing.locate_spec, job))
            _timed(rounds, partial(processing.complete_locate, job, result))
    assert statistics.median(accepts) <= ACCEPT_MS
    assert sum(rounds) / len(accepts) <= ROUND_MS


def test_a_deep_queue_does_not_slow_claims(world: World) -> None:
    level = world.mapped_level()
    session_ids = [world.session(level.id).id for _ in range(3)]
    for session_id in session_ids:
        for seq in range(100):
            world.services.sessions.accept(session_id, new_segment(seq, n=5))
    claims: list[float] = []
    result = locate_result(level_id=level.id)
    for _ in range(30):
        (job,) = _timed(claims, lambda: world.services.processing.claim(1, JobKind.LOCATE_SEGMENT))
        world.services.processing.complete_locate(job, result)
    assert statistics.median(claims) <= ACCEPT_MS
