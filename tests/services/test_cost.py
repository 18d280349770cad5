"""What a segment costs the service beside its location: counted in statements, whatever else the machine does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from sqlalchemy import event

from app.services.records import JobKind
from tests.support.builders import World, locate_result, new_segment

ACCEPT_STATEMENTS = 9
ROUND_STATEMENTS = 24


@contextmanager
def _statements(world: World) -> Iterator[list[str]]:
    """The SQL sent while the block runs, transactions' ends included."""
    sent: list[str] = []
    engine = world.database.engine

    def executed(_connection: object, _cursor: object, statement: str, *_rest: object) -> None:
        sent.append(statement)

    def committed(_connection: object) -> None:
        sent.append("COMMIT")

    event.listen(engine, "before_cursor_execute", executed)
    event.listen(engine, "commit", committed)
    try:
        yield sent
    finally:
        event.remove(engine, "before_cursor_execute", executed)
        event.remove(engine, "commit", committed)


@pytest.mark.parametrize("waiting", [1, 100])
def test_a_segment_costs_few_statements_however_deep_the_queue(world: World, waiting: int) -> None:
    level = world.mapped_level()
    session_ids = [world.session(level.id).id for _ in range(3)]
    result = locate_result(level_id=level.id, n_fixes=10, n_lagged=9, payload=bytes(200_000))
    processing, accept = world.services.processing, world.services.sessions.accept
    for session_id in session_ids:
        for seq in range(waiting):
            accept(session_id, new_segment(seq, n=5))
    with _statements(world) as accepting:
        accept(session_ids[0], new_segment(waiting, n=5))
    with _statements(world) as processed:
        (job,) = processing.claim(1, JobKind.LOCATE_SEGMENT)
        processing.locate_spec(job)
        processing.complete_locate(job, result)
    assert accepting.count("COMMIT") == 1
    assert len(accepting) <= ACCEPT_STATEMENTS, accepting
    assert processed.count("COMMIT") <= 4
    assert len(processed) <= ROUND_STATEMENTS, processed


def test_a_claim_reads_no_job_but_its_own(world: World) -> None:
    level = world.mapped_level()
    for session_id in [world.session(level.id).id for _ in range(3)]:
        world.services.sessions.accept(session_id, new_segment(0, n=5))
    with _statements(world) as claiming:
        world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    (search,) = [statement for statement in claiming if statement.startswith("SELECT") and "ORDER BY" in statement]
    with world.database.engine.connect() as connection:
        plan = connection.exec_driver_sql(
            "EXPLAIN QUERY PLAN " + search, tuple(1 for _ in range(search.count("?")))
        ).fetchall()
    steps = [str(row[-1]) for row in plan]
    assert any("USING" in step and "INDEX" in step for step in steps), steps
    assert not any(step.startswith("SCAN jobs") and "INDEX" not in step for step in steps), steps
