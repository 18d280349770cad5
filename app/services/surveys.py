"""Surveys and the walks uploaded to them."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from app.engine.types import Waypoints
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.errors import InvalidError, NotFoundError
from app.services.ids import new_id
from app.services.records import NewWalk, Page, Survey, Walk
from app.services.walk_tracks import WalkTrack


class SurveyService(Service):
    """Create surveys, take walks."""

    def create(self, level_id: str, name: str) -> Survey:
        """Create a survey of a level."""
        now = self._clock()
        survey = Survey(new_id("srv", now), level_id, name, n_walks=0, created_at=now)
        with self._uow(write=True) as uow:
            uow.levels.get(level_id)
            uow.surveys.add(survey)
        return survey

    def get(self, survey_id: str) -> Survey:
        """One survey."""
        with self._uow() as uow:
            return uow.surveys.get(survey_id)

    def list(self, level_id: str | None = None, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[Survey]:
        """Surveys, newest first, of one level if it is named."""
        with self._uow() as uow:
            if level_id is not None:
                uow.levels.get(level_id)
            return uow.surveys.list(level_id=level_id, cursor=cursor, limit=check_limit(limit))

    def add_walk(self, survey_id: str, new: NewWalk) -> tuple[Walk, bool]:
        """Store a walk. The flag says that this content was there already: then nothing is stored."""
        walk = new_walk_record(survey_id, new, self._clock())
        with self._uow(write=True) as uow:
            uow.surveys.get(survey_id)
            known = uow.surveys.find_walk(survey_id, new.content_hash)
            if known is not None:
                return known, True
            if new.device_id is not None:
                uow.devices.get(new.device_id)
            elif new.calibration_epoch:
                remedy = "name the device in device_id, or leave the epoch out"
                raise InvalidError("calibration_epoch", "belongs to no device", remedy)
            uow.surveys.add_walk(walk, new)
        return walk, False

    def get_walk(self, survey_id: str, walk_id: str) -> Walk:
        """One walk of a survey."""
        with self._uow() as uow:
            return _of_survey(survey_id, uow.surveys.get_walk(walk_id))

    def list_walks(self, survey_id: str, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[Walk]:
        """Walks of a survey, oldest first."""
        with self._uow() as uow:
            uow.surveys.get(survey_id)
            return uow.surveys.list_walks(survey_id, cursor=cursor, limit=check_limit(limit))

    def find_walk(self, survey_id: str, content_hash: str) -> Walk | None:
        """The walk of this content, if the survey has it."""
        with self._uow() as uow:
            return uow.surveys.find_walk(survey_id, content_hash)

    def list_tracks(
        self, level_id: str, cursor: str | None = None, limit: int = DEFAULT_LIMIT, *, survey_id: str | None = None
    ) -> Page[WalkTrack]:
        """Where the walks of a level (of one survey, if it is named) went, oldest first."""
        with self._uow() as uow:
            uow.levels.get(level_id)
            surveys = () if survey_id is None else (uow.surveys.get(survey_id).id,)
            return uow.surveys.list_tracks(level_id, surveys, cursor=cursor, limit=check_limit(limit))

    def delete_walk(self, survey_id: str, walk_id: str) -> None:
        """Delete a walk; maps built from it stay as they are."""
        with self._uow(write=True) as uow:
            _of_survey(survey_id, uow.surveys.get_walk(walk_id))
            uow.surveys.delete_walk(walk_id)


def _of_survey(survey_id: str, walk: Walk) -> Walk:
    if walk.survey_id != survey_id:
        raise NotFoundError("walk", walk.id)
    return walk


def new_walk_record(survey_id: str, new: NewWalk, now: datetime) -> Walk:
    """A walk as it is stored, without its samples."""
    return Walk(
        id=new_id("wlk", now),
        survey_id=survey_id,
        name=new.name,
        device_id=new.device_id,
        n_samples=len(new.samples),
        n_waypoints=len(new.waypoints),
        duration_s=float(new.samples.t[-1] - new.samples.t[0]),
        length_m=_length_m(new.waypoints),
        content_hash=new.content_hash,
        created_at=now,
        calibration_epoch=new.calibration_epoch,
    )


def _length_m(waypoints: Waypoints) -> float:
    return float(np.hypot(np.diff(waypoints.x), np.diff(waypoints.y)).sum())
