"""Contributions of sessions to maps, their rows, and changes of the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any

from sqlalchemy import Row, delete, func, insert, select, update

from app.engine.types import Evidence, FeatureSet
from app.services.ports import Box
from app.services.records import Contribution, ContributionState, ContributionVerdict, LastingChange, Page
from app.storage.evidence import pack_rows, unpack_evidence
from app.storage.models import contribution_rows, contributions, field_changes
from app.storage.repositories.base import Repository, expect_one

_CHUNK = 500  # parameters of one IN list; SQLite takes at least 999
_LIVE = (
    ContributionState.OFFERED,
    ContributionState.USED,
    ContributionState.WAITING,
    ContributionState.QUARANTINED,
)


class SqlContributionRepository(Repository):
    """Port ``ContributionRepository``."""

    def add(self, contribution: Contribution, rows: Evidence) -> None:
        """Store a contribution with its rows."""
        values = asdict(contribution) | {"reasons": list(contribution.reasons)}
        values["box"] = None if contribution.box is None else list(contribution.box)
        self._write(insert(contributions).values(values))
        if len(rows):
            self._write(insert(contribution_rows).values(contribution_id=contribution.id, data=pack_rows(rows)))

    def get(self, contribution_id: str) -> Contribution:
        """One contribution, without its rows."""
        statement = select(contributions).where(contributions.c.id == contribution_id)
        return _contribution(self._one("contribution", contribution_id, statement))

    def list(
        self,
        *,
        level_id: str | None,
        session_id: str | None,
        contributor: str | None,
        state: ContributionState | None,
        cursor: str | None,
        limit: int,
    ) -> Page[Contribution]:
        """Contributions, newest first."""
        statement = select(contributions)
        wanted = {"level_id": level_id, "session_id": session_id, "contributor": contributor, "state": state}
        for name, value in wanted.items():
            if value is not None:
                statement = statement.where(contributions.c[name] == value)
        return self._newest_first(statement, contributions.c.id, _contribution, cursor=cursor, limit=limit)

    def of_session(self, session_id: str) -> Sequence[Contribution]:
        """What a session contributed, one a level."""
        statement = select(contributions).where(contributions.c.session_id == session_id)
        return [_contribution(row) for row in self._read(statement.order_by(contributions.c.id))]

    def live(self, level_id: str) -> Sequence[str]:
        """Ids of those that are to be among the evidence of the level's map, oldest first."""
        statement = select(contributions.c.id).where(
            contributions.c.level_id == level_id, contributions.c.state.in_(_LIVE)
        )
        return self._read(statement.order_by(contributions.c.id)).scalars().all()

    def load(self, features: FeatureSet, ids: Sequence[str]) -> Evidence:
        """Rows of these contributions, in this order as far as they have any."""
        statement = select(contribution_rows.c.data).where(contribution_rows.c.contribution_id.in_(ids))
        return unpack_evidence(
            features, self._read(statement.order_by(contribution_rows.c.contribution_id)).scalars().all()
        )

    def decide(self, verdicts: Sequence[ContributionVerdict], now: datetime) -> None:
        """Note what the weighing found; what a person rejected stays so."""
        for one in verdicts:
            statement = update(contributions).where(
                contributions.c.id == one.id, contributions.c.state != ContributionState.REJECTED
            )
            self._write(
                statement.values(
                    state=one.state,
                    verdict=one.verdict,
                    n_agreed=one.n_agreed,
                    n_disagreed=one.n_disagreed,
                    decided_at=now,
                )
            )

    def set_state(self, contribution_id: str, state: ContributionState, now: datetime) -> Contribution:
        """A person's decision; what the weighing said no longer holds."""
        statement = update(contributions).where(contributions.c.id == contribution_id)
        values = {"state": state, "decided_at": now, "verdict": ""}
        expect_one(self._write(statement.values(values)), "contribution", contribution_id)
        return self.get(contribution_id)

    def delete(self, contribution_id: str) -> None:
        """Forget a contribution and its rows; maps lose it with their next update."""
        self._write(delete(contribution_rows).where(contribution_rows.c.contribution_id == contribution_id))
        statement = delete(contributions).where(contributions.c.id == contribution_id)
        expect_one(self._write(statement), "contribution", contribution_id)

    def boxes(self, ids: Sequence[str]) -> Mapping[str, Box]:
        """Where the rows of these contributions lie, of those that have any."""
        found: dict[str, Box] = {}
        for start in range(0, len(ids), _CHUNK):
            chunk = ids[start : start + _CHUNK]
            rows = self._read(select(contributions.c.id, contributions.c.box).where(contributions.c.id.in_(chunk)))
            found |= {row.id: tuple(row.box) for row in rows if row.box is not None}
        return found

    def track_record(self, *, other_than: str) -> Mapping[str, tuple[int, int]]:
        """Places where contributors agreed with independent evidence and where not, on levels but this one."""
        agreed, disagreed = (func.sum(contributions.c[name]).label(name) for name in ("n_agreed", "n_disagreed"))
        statement = select(contributions.c.contributor, agreed, disagreed).where(contributions.c.level_id != other_than)
        rows = self._read(statement.group_by(contributions.c.contributor))
        return {row.contributor: (int(row.n_agreed), int(row.n_disagreed)) for row in rows}

    def add_changes(self, changes: Sequence[LastingChange]) -> None:
        """Note changes of the field."""
        if changes:
            self._write(insert(field_changes), [_change_values(change) for change in changes])

    def list_changes(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[LastingChange]:
        """Changes of the field, newest first."""
        statement = select(field_changes)
        if level_id is not None:
            statement = statement.where(field_changes.c.level_id == level_id)
        return self._newest_first(statement, field_changes.c.id, _change, cursor=cursor, limit=limit)


def _contribution(row: Row[Any]) -> Contribution:
    values = dict(row._mapping)
    box = values.pop("box")
    return Contribution(
        **{
            **values,
            "state": ContributionState(values["state"]),
            "reasons": tuple(values["reasons"]),
            "box": None if box is None else tuple(box),
        }
    )


def _change_values(change: LastingChange) -> dict[str, Any]:
    return asdict(change) | {"box": list(change.box), "delta": list(change.delta)}


def _change(row: Row[Any]) -> LastingChange:
    values = dict(row._mapping)
    return LastingChange(**{**values, "box": tuple(values["box"]), "delta": tuple(values["delta"])})
