"""Surveys and their walks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Row, Select, delete, func, insert, select, update

from app.engine.types import SurveyWalk
from app.services.records import Carrier, NewWalk, Page, Survey, Walk
from app.services.walk_tracks import WalkTrack
from app.storage.columns import (
    decode_samples,
    decode_scans,
    decode_waypoints,
    encode_samples,
    encode_scans,
    encode_waypoints,
)
from app.storage.models import surveys, walk_samples, walks
from app.storage.repositories.base import Repository, expect_one, page

_MARK_CHUNK = 500  # parameters of one IN list; SQLite takes at least 999
_N_WALKS = select(func.count()).where(walks.c.survey_id == surveys.c.id).scalar_subquery()
_SELECT = select(surveys, _N_WALKS.label("n_walks"))
_RECORDED = tuple(walk_samples.c[name] for name in ("samples", "waypoints", "wifi", "ble"))


class SqlSurveyRepository(Repository):
    """Port ``SurveyRepository``."""

    def add(self, survey: Survey) -> None:
        """Store a survey."""
        self._write(
            insert(surveys).values(
                id=survey.id, level_id=survey.level_id, name=survey.name, created_at=survey.created_at
            )
        )

    def get(self, survey_id: str) -> Survey:
        """One survey."""
        return _survey(self._one("survey", survey_id, _SELECT.where(surveys.c.id == survey_id)))

    def list(self, *, level_id: str | None, cursor: str | None, limit: int) -> Page[Survey]:
        """Surveys, newest first."""
        statement = _SELECT if level_id is None else _SELECT.where(surveys.c.level_id == level_id)
        return self._newest_first(statement, surveys.c.id, _survey, cursor=cursor, limit=limit)

    def add_walk(self, walk: Walk, data: NewWalk) -> None:
        """Store a walk with its samples."""
        self._write(
            insert(walks).values(
                id=walk.id,
                survey_id=walk.survey_id,
                name=walk.name,
                device_id=walk.device_id,
                n_samples=walk.n_samples,
                n_waypoints=walk.n_waypoints,
                duration_s=walk.duration_s,
                length_m=walk.length_m,
                content_hash=walk.content_hash,
                created_at=walk.created_at,
                calibration_epoch=walk.calibration_epoch,
            )
        )
        self._write(
            insert(walk_samples).values(
                walk_id=walk.id,
                samples=encode_samples(data.samples),
                waypoints=encode_waypoints(data.waypoints),
                wifi=None if data.wifi is None else encode_scans(data.wifi),
                ble=None if data.ble is None else encode_scans(data.ble),
            )
        )

    def get_walk(self, walk_id: str) -> Walk:
        """One walk, without its samples."""
        return _walk(self._one("walk", walk_id, select(walks).where(walks.c.id == walk_id)))

    def find_walk(self, survey_id: str, content_hash: str) -> Walk | None:
        """The walk of this content, if the survey has it."""
        statement = select(walks).where(walks.c.survey_id == survey_id, walks.c.content_hash == content_hash)
        row = self._read(statement).one_or_none()
        return None if row is None else _walk(row)

    def find_walks(self, walk_ids: Sequence[str]) -> Mapping[str, Walk]:
        """Those of these walks that are stored (still), by id."""
        rows = self._read(select(walks).where(walks.c.id.in_(walk_ids)))
        return {row.id: _walk(row) for row in rows}

    def list_walks(self, survey_id: str, *, cursor: str | None, limit: int) -> Page[Walk]:
        """Walks of a survey, oldest first."""
        statement = select(walks).where(walks.c.survey_id == survey_id)
        if cursor is not None:
            statement = statement.where(walks.c.id > cursor)
        rows = self._read(statement.order_by(walks.c.id).limit(limit + 1)).all()
        return page(rows, _walk, lambda row: str(row.id), limit=limit)

    def list_tracks(
        self, level_id: str, survey_ids: Sequence[str], *, cursor: str | None, limit: int
    ) -> Page[WalkTrack]:
        """Where the level's walks (of these surveys only, when any are named) went, oldest first."""
        statement = _of_level(select(walks, walk_samples.c.waypoints), level_id, survey_ids).join(
            walk_samples, walk_samples.c.walk_id == walks.c.id
        )
        if cursor is not None:
            statement = statement.where(walks.c.id > cursor)
        rows = self._read(statement.order_by(walks.c.id).limit(limit + 1)).all()
        return page(rows, _track, lambda row: str(row.id), limit=limit)

    def delete_walk(self, walk_id: str) -> None:
        """Delete a walk with its samples."""
        self._write(delete(walk_samples).where(walk_samples.c.walk_id == walk_id))
        expect_one(self._write(delete(walks).where(walks.c.id == walk_id)), "walk", walk_id)

    def count_walks(self, level_id: str, survey_ids: Sequence[str]) -> int:
        """How many walks a build from these surveys would read."""
        return int(self._read(_of_level(select(func.count()), level_id, survey_ids)).scalar_one())

    def walk_ids(self, level_id: str, survey_ids: Sequence[str]) -> Sequence[str]:
        """Ids of the level's walks (of these surveys only, when any are named), oldest first."""
        return self._read(_of_level(select(walks.c.id), level_id, survey_ids).order_by(walks.c.id)).scalars().all()

    def carriers(self, level_id: str) -> Mapping[str, Carrier]:
        """The device of each of the level's walks that name one, by walk id."""
        columns = (walks.c.id, walks.c.device_id, walks.c.calibration_epoch, walks.c.offset_remembered_at)
        statement = _of_level(select(*columns), level_id, ()).where(walks.c.device_id.is_not(None))
        return {
            row.id: Carrier(row.device_id, row.calibration_epoch, row.offset_remembered_at is not None)
            for row in self._read(statement)
        }

    def mark_offsets_remembered(self, walk_ids: Sequence[str], now: datetime) -> None:
        """Note that these walks' offsets are in their devices' memories."""
        for start in range(0, len(walk_ids), _MARK_CHUNK):
            chunk = walk_ids[start : start + _MARK_CHUNK]
            self._write(update(walks).where(walks.c.id.in_(chunk)).values(offset_remembered_at=now))

    def load_walks(
        self, level_id: str, survey_ids: Sequence[str], *, only: Sequence[str] | None = None
    ) -> Sequence[SurveyWalk]:
        """Samples of the level's walks (of these surveys, or only these walks, when any are named), oldest first."""
        statement = _of_level(select(walks.c.id, *_RECORDED), level_id, survey_ids).join(
            walk_samples, walk_samples.c.walk_id == walks.c.id
        )
        if only is not None:
            statement = statement.where(walks.c.id.in_(only))
        return [_recorded(row) for row in self._read(statement.order_by(walks.c.id))]

    def load_walk(self, walk_id: str) -> SurveyWalk:
        """Samples of one walk."""
        statement = select(walk_samples.c.walk_id.label("id"), *_RECORDED).where(walk_samples.c.walk_id == walk_id)
        return _recorded(self._one("walk", walk_id, statement))


def _recorded(row: Row[Any]) -> SurveyWalk:
    return SurveyWalk(
        walk_id=row.id,
        samples=decode_samples(row.samples),
        waypoints=decode_waypoints(row.waypoints),
        wifi=None if row.wifi is None else decode_scans(row.wifi),
        ble=None if row.ble is None else decode_scans(row.ble),
    )


def _of_level(statement: Select[Any], level_id: str, survey_ids: Sequence[str]) -> Select[Any]:
    statement = statement.select_from(walks).join(surveys, surveys.c.id == walks.c.survey_id)
    statement = statement.where(surveys.c.level_id == level_id)
    return statement.where(surveys.c.id.in_(survey_ids)) if survey_ids else statement


def _survey(row: Row[Any]) -> Survey:
    return Survey(row.id, row.level_id, row.name, n_walks=row.n_walks, created_at=row.created_at)


def _track(row: Row[Any]) -> WalkTrack:
    return WalkTrack(_walk(row), decode_waypoints(row.waypoints))


def _walk(row: Row[Any]) -> Walk:
    return Walk(
        id=row.id,
        survey_id=row.survey_id,
        name=row.name,
        device_id=row.device_id,
        n_samples=row.n_samples,
        n_waypoints=row.n_waypoints,
        duration_s=row.duration_s,
        length_m=row.length_m,
        content_hash=row.content_hash,
        created_at=row.created_at,
        calibration_epoch=row.calibration_epoch,
    )
