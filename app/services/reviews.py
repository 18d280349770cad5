"""From what the weighing of evidence found to what is kept of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from app.engine.mapping.crowd.changes import ChangeEvent
from app.engine.mapping.crowd.policy import Reason
from app.engine.mapping.crowd.weigh import Verdict
from app.services.base import MAX_LIMIT
from app.services.ids import new_id
from app.services.ports import UnitOfWork
from app.services.records import ContributionState, ContributionVerdict, LastingChange, MapInfo

_PRIOR = (2.0, 1.0)
"""Agreeing and disagreeing places of a contributor nobody knows."""


def reputation_of(track_record: Mapping[str, tuple[int, int]]) -> dict[str, float]:
    """Mean of a Beta distribution for each contributor."""
    return {
        name: (_PRIOR[0] + agreed) / (sum(_PRIOR) + agreed + disagreed)
        for name, (agreed, disagreed) in track_record.items()
        if agreed + disagreed
    }


def verdict_of(verdict: Verdict) -> ContributionVerdict:
    """What a contribution's record says of its verdict."""
    used = sum(count for action, count in verdict.cells if action.used)
    cells = sum(count for _, count in verdict.cells)
    if used:
        state = ContributionState.USED
    elif verdict.reason is Reason.ALONE:
        state = ContributionState.WAITING
    else:
        state = ContributionState.QUARANTINED
    actions = ", ".join(f"{action.value} {count}" for action, count in verdict.cells)
    words = "" if verdict.reason is None else f"{verdict.reason.words}; "
    return ContributionVerdict(
        id=verdict.source_id,
        state=state,
        verdict=f"{words}{used} of {cells} square metres used ({actions})",
        n_agreed=verdict.agreed,
        n_disagreed=verdict.judged - verdict.agreed,
    )


def news(uow: UnitOfWork, info: MapInfo, events: Sequence[ChangeEvent], now: datetime) -> list[LastingChange]:
    """Changes that are not noted yet: what was found before is found again whenever the place is weighed."""
    if not events:
        return []
    known = uow.contributions.list_changes(level_id=info.level_id, cursor=None, limit=MAX_LIMIT).items
    found = [_change(info, event, now) for event in events]
    return [one for one in found if not any(_same(one, other) for other in known)]


def _change(info: MapInfo, event: ChangeEvent, now: datetime) -> LastingChange:
    cells, half = np.array(event.cells), 0.5 * event.cell_m
    (x_min, y_min), (x_max, y_max) = cells.min(axis=0) - half, cells.max(axis=0) + half
    return LastingChange(
        id=new_id("chg", now),
        level_id=info.level_id,
        map_id=info.id,
        box=(float(x_min), float(y_min), float(x_max), float(y_max)),
        area_m2=len(cells) * event.cell_m**2,
        delta=event.delta,
        after=_time(event.after_t),
        before=_time(event.before_t),
        created_at=now,
    )


def _time(t: float) -> datetime | None:
    return datetime.fromtimestamp(t, UTC) if np.isfinite(t) and t > 0.0 else None


def _same(one: LastingChange, other: LastingChange) -> bool:
    """Whether they overlap in place and in time: later passes only narrow a change down."""
    apart = (
        one.box[0] > other.box[2] or other.box[0] > one.box[2] or one.box[1] > other.box[3] or other.box[1] > one.box[3]
    )
    begun, ended = (datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC))
    early = (one.before or ended) < (other.after or begun)
    late = (one.after or begun) > (other.before or ended)
    return not (apart or early or late)
