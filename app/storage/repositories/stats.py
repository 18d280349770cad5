"""Counts for operators."""

from __future__ import annotations

from sqlalchemy import Connection, Table, func, select

from app.services.records import JobState, SessionStatus, Stats
from app.storage.models import jobs, levels, maps, segments, sessions, surveys, venues, walks


def read_stats(connection: Connection) -> Stats:
    """Counts of everything stored."""
    by_state = connection.execute(select(jobs.c.state, func.count()).group_by(jobs.c.state)).all()
    found = {JobState(state): count for state, count in by_state}
    # fixes are many times as many as segments, which know how many they gave
    n_fixes = func.coalesce(func.sum(segments.c.n_fixes), 0)
    n_segments, fixes = connection.execute(select(func.count(), n_fixes).select_from(segments)).one()
    is_open = select(func.count()).where(sessions.c.status == SessionStatus.OPEN)
    return Stats(
        venues=_count(connection, venues),
        levels=_count(connection, levels),
        surveys=_count(connection, surveys),
        walks=_count(connection, walks),
        maps=_count(connection, maps),
        sessions_open=int(connection.execute(is_open).scalar_one()),
        sessions=_count(connection, sessions),
        segments=int(n_segments),
        fixes=int(fixes),
        jobs_by_state={state: found.get(state, 0) for state in JobState},
    )


def _count(connection: Connection, table: Table) -> int:
    return int(connection.execute(select(func.count()).select_from(table)).scalar_one())
