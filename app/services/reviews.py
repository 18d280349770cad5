"""From what the weighing of evidence found to what is kept of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from app.engine.mapping.crowd.changes import ChangeEvent
from app.engine.mapping.crowd.policy import Reason, TrustPolicy
from app.engine.mapping.crowd.reputation import posterior
from app.engine.mapping.crowd.weigh import Verdict
from app.services.base import MAX_LIMIT
from app.services.ids import new_id
from app.services.ports import UnitOfWork
from app.services.records import (
    Contribution,
    ContributionState,
    ContributionVerdict,
    LastingChange,
    MapInfo,
    Session,
)
from app.services.tasks import BuildResult, Offer

_ABOUT_M = 2.0
"""Ground about a row that it is compared with."""
_POLICY = TrustPolicy()


def reputation_of(track_record: Mapping[str, tuple[int, int]]) -> dict[str, float]:
    """What other levels tell of contributors that were compared with anybody there, 0 to 1."""
    names = [name for name, counts in track_record.items() if sum(counts)]
    agreed, disagreed = np.array([track_record[name] for name in names], dtype=np.float64).reshape(-1, 2).T
    like, unlike = (np.full(len(names), value) for value in _POLICY.reputation_prior)
    told = posterior((like, unlike), agreed, agreed + disagreed, _POLICY)
    return dict(zip(names, told.tolist(), strict=True))


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


def whole_verdicts(uow: UnitOfWork, result: BuildResult) -> list[Verdict]:
    """Verdicts on contributions all of which was weighed; what an update saw a part of keeps the verdict it has."""
    base = result.base
    if base is None:
        return list(result.verdicts)
    added = set(base.added)
    boxes = uow.contributions.boxes([one.source_id for one in result.verdicts if one.source_id not in added])
    x_min, y_min, x_max, y_max = base.box
    x_min, y_min, x_max, y_max = x_min + _ABOUT_M, y_min + _ABOUT_M, x_max - _ABOUT_M, y_max - _ABOUT_M
    inside = {
        name for name, box in boxes.items()
        if box[0] >= x_min and box[1] >= y_min and box[2] <= x_max and box[3] <= y_max
    }  # fmt: skip
    return [one for one in result.verdicts if one.source_id in added or one.source_id in inside]


def contribution_of(session: Session, offer: Offer, now: datetime) -> Contribution:
    """The rows' one source names the contribution."""
    rows = offer.evidence
    box = None
    if len(rows):
        lo, hi = rows.xy.min(axis=0), rows.xy.max(axis=0)
        box = (float(lo[0]), float(lo[1]), float(hi[0]), float(hi[1]))
    return Contribution(
        id=rows.sources[0].id if len(rows) else new_id("ctr", now),
        session_id=session.id,
        level_id=offer.level_id,
        device_id=session.device_id,
        contributor=session.contributor or "",
        map_id=next(one.map_id for one in session.maps if one.level_id == offer.level_id),
        state=ContributionState.OFFERED if len(rows) else ContributionState.EMPTY,
        n_steps=offer.n_steps,
        n_kept=offer.n_kept,
        n_rows=len(rows),
        reasons=offer.reasons,
        box=box,
        n_agreed=0,
        n_disagreed=0,
        verdict="",
        created_at=now,
        decided_at=None,
    )
