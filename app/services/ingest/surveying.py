"""A survey recording becomes walks: annotations at marked points are its waypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from app.engine.types import SurveyWalk, Waypoints
from app.exchange.phones.assembly import assemble
from app.exchange.phones.places import marker_key, waypoints_of
from app.exchange.phones.readings import Annotation, Readings
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

_SHOWN = 5
MAX_PROBLEM = 1000


def resolve(
    notes: Sequence[Annotation], markers: Sequence[Marker], route: Sequence[str] = ()
) -> tuple[Waypoints, tuple[str, ...]]:
    """Waypoints of annotations, and the texts that name no place.

    A text is the name of a marker, or a place in level metres. Where no text is either, the annotations are the markers
    of the ``route`` in its order: presses of a button.
    """
    places = {marker_key(marker.name): (marker.x, marker.y) for marker in markers}
    waypoints, unknown = waypoints_of(notes, places)
    if route and not len(waypoints):
        pressed = [replace(note, text=name) for note, name in zip(notes, route, strict=False)]
        waypoints, unknown = waypoints_of(pressed, places)
        unknown += tuple(note.text for note in notes[len(route) :])
    return waypoints, unknown


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
    found, unknown = resolve(recording.annotations, uow.ingest.markers(level_id), token.route)
    readings = Readings.merged(Readings.unpack(one.readings) for one in uow.ingest.messages(recording.id))
    samples = assemble(readings, token.frame, final=True).samples
    findings = Findings()
    walks: list[SurveyWalk] = []
    if samples is not None:
        name = f"{token.name} {recording.opened_at:%Y-%m-%d %H:%M:%S}"
        whole = Recording(name, samples, found if waypoints is None else waypoints)
        walks = list(walks_of(whole, None, findings))
    else:
        findings.skipped.append("no samples: the phone did not send all of magnetometer, accelerometer and gyroscope")
    ids, problems = _stored(uow, checks, token, recording, walks, now)
    problem = "; ".join([*problems, *findings.skipped, *(_unknown(unknown) if waypoints is None else ())])
    n_samples = 0 if samples is None else len(samples)
    state = RecordingState.CLOSED if ids else RecordingState.WAITING
    recording = replace(
        recording, state=state, closed_at=now, walk_ids=ids, n_samples=n_samples, problem=problem[:MAX_PROBLEM]
    )
    if not ids:
        return recording, []
    uow.ingest.drop_readings(recording.id)
    return recording, _ordered(uow, token, now)


def _unknown(texts: Sequence[str]) -> list[str]:
    if not texts:
        return []
    names = ", ".join(text.strip() or "(no text)" for text in texts[:_SHOWN])
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
