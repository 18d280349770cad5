"""A survey recording becomes walks: annotations at marked points are its waypoints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from app.engine.types import SurveyWalk, Waypoints
from app.exchange.phones.assembly import assemble
from app.exchange.phones.readings import NS, Annotation, Readings
from app.exchange.surveys.recording import Findings, Recording, walks_of
from app.services.errors import InvalidError
from app.services.ingest.ports import UploadChecks
from app.services.ingest.records import (
    BuildOnArrival,
    IngestToken,
    Marker,
    RecordingInfo,
    RecordingState,
)
from app.services.map_changes import build_job, can_update
from app.services.ports import UnitOfWork
from app.services.records import Job, MapKind, NewBuild
from app.services.surveys import new_walk_record

_PAIR = re.compile(r"^\s*\(?\s*(-?\d+(?:\.\d+)?)\s*[,;\s]\s*(-?\d+(?:\.\d+)?)\s*\)?\s*$")
_SHOWN = 5
MAX_PROBLEM = 1000


@dataclass(frozen=True, slots=True)
class Resolved:
    """Where annotations were set, and what of them nobody understands."""

    waypoints: Waypoints
    unknown: tuple[str, ...]


def resolve(notes: Sequence[Annotation], markers: Sequence[Marker], route: Sequence[str] = ()) -> Resolved:
    """Waypoints of annotations.

    A text is the name of a marker (upper and lower case are the same), or a place in level metres (``12.5, 3``). Where
    no text is either, the annotations are the markers of the ``route``, in its order: presses of a button.
    """
    places = {marker.name.strip().casefold(): (marker.x, marker.y) for marker in markers}
    found = [places.get(note.text.strip().casefold()) or _pair(note.text) for note in notes]
    if route and not any(found):
        found = [places.get(name.strip().casefold()) for name in route[: len(notes)]]
        found += [None] * (len(notes) - len(found))
    known = [(note.t_ns / NS, *place) for note, place in zip(notes, found, strict=True) if place is not None]
    unknown = tuple(note.text.strip() or "(no text)" for note, place in zip(notes, found, strict=True) if place is None)
    columns = np.array(known, dtype=np.float64).reshape(-1, 3)
    return Resolved(Waypoints(columns[:, 0], columns[:, 1], columns[:, 2]), unknown)


def _pair(text: str) -> tuple[float, float] | None:
    match = _PAIR.match(text)
    return None if match is None else (float(match.group(1)), float(match.group(2)))


def finish_survey(
    uow: UnitOfWork,
    checks: UploadChecks,
    token: IngestToken,
    recording: RecordingInfo,
    now: datetime,
    waypoints: Waypoints | None = None,
) -> tuple[RecordingInfo, list[Job]]:
    """Make walks of a survey recording, and order the map that the token asks for.

    Parameters
    ----------
    waypoints : Waypoints or None
        In place of the annotations.

    Returns
    -------
    tuple
        The recording, closed, or waiting with a ``problem`` if there are too few waypoints; jobs to be told of.
    """
    level_id = token.level_id or ""
    resolved = resolve(recording.annotations, uow.ingest.markers(level_id), token.route)
    readings = Readings.merged(Readings.unpack(one.readings) for one in uow.ingest.messages(recording.id))
    samples = assemble(readings, token.frame, final=True).samples
    findings = Findings()
    walks: list[SurveyWalk] = []
    if samples is not None:
        name = f"{token.name} {recording.opened_at:%Y-%m-%d %H:%M:%S}"
        whole = Recording(name, samples, resolved.waypoints if waypoints is None else waypoints)
        walks = list(walks_of(whole, None, findings))
    else:
        findings.skipped.append("no samples: the phone did not send all of magnetometer, accelerometer and gyroscope")
    ids, problems = _stored(uow, checks, token, recording, walks, now)
    problem = "; ".join([*problems, *findings.skipped, *(_unknown(resolved) if waypoints is None else ())])
    n_samples = 0 if samples is None else len(samples)
    state = RecordingState.CLOSED if ids else RecordingState.WAITING
    recording = replace(
        recording, state=state, closed_at=now, walk_ids=ids, n_samples=n_samples, problem=problem[:MAX_PROBLEM]
    )
    if not ids:
        return recording, []
    uow.ingest.drop_readings(recording.id)
    return recording, _ordered(uow, token, now)


def _unknown(resolved: Resolved) -> list[str]:
    if not resolved.unknown:
        return []
    names = ", ".join(resolved.unknown[:_SHOWN])
    return [f"annotations that are neither a marker of the level nor a place in metres: {names}"]


def _stored(
    uow: UnitOfWork,
    checks: UploadChecks,
    token: IngestToken,
    recording: RecordingInfo,
    walks: Sequence[SurveyWalk],
    now: datetime,
) -> tuple[tuple[str, ...], list[str]]:
    """Ids of the walks that are stored, and why others are not."""
    extent = uow.levels.get(token.level_id or "").extent
    survey_id = recording.survey_id or ""
    ids: list[str] = []
    problems: list[str] = []
    for walk in walks:
        try:
            new = checks.walk(walk, recording.device_id, extent, now)
        except InvalidError as error:
            problems.append(f"{error.field} {error.message}: {error.remedy}")
            continue
        known = uow.surveys.find_walk(survey_id, new.content_hash)
        if known is None:
            known = new_walk_record(survey_id, new, now)
            uow.surveys.add_walk(known, new)
        ids.append(known.id)
    return tuple(ids), problems


def _ordered(uow: UnitOfWork, token: IngestToken, now: datetime) -> list[Job]:
    """The job that brings the level's map up to date with its walks, unless one waits already."""
    level_id = token.level_id or ""
    if token.build is BuildOnArrival.NONE:
        return []
    publish = token.build is BuildOnArrival.PUBLISH
    if publish and uow.maps.awaits_build(level_id):
        return []
    current = uow.levels.get(level_id).current_map_id
    update = publish and current is not None and can_update(uow.maps.get(current))
    new = NewBuild(level_id, mode=MapKind.UPDATE if update else MapKind.BUILD, publish=publish, key_id=token.key_id)
    job = build_job(new, now)
    uow.jobs.add(job)
    uow.maps.add_build(job.id, new)
    return [job]
