"""A file of survey recordings on its way into a survey.

A walk passes the checks of ``POST /v1/surveys/{survey_id}/walks``, as the body that would have been sent there:
a file is no way around them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

from app.api.body import MSGPACK
from app.api.deps import Context
from app.api.errors import RejectedError
from app.api.schemas.samples import Frame, WalkIn
from app.api.schemas.survey_files import ImportedWalkOut, SurveyImportOut, WalkFate
from app.api.structure import WALK_BOUNDS
from app.api.uploads import new_walk, parse
from app.api.validation import FieldError
from app.engine.errors import InputError
from app.engine.types import SurveyWalk
from app.exchange.phones.places import marker_key
from app.exchange.survey_formats import FileChoices, SurveyFormat, read_recording
from app.exchange.surveys import Findings, walk_body
from app.services.exchange import refused
from app.services.records import Level, NewWalk, Walk

_MAX_NAME = 200
_CONTROL = re.compile(r"[\x00-\x1f\x7f]+")


def import_recording(
    context: Context,
    survey_id: str,
    content: bytes,
    kind: SurveyFormat,
    choices: FileChoices,
    *,
    frame: Frame = Frame.ANDROID,
    radio: bool = False,
    dry_run: bool = False,
) -> SurveyImportOut:
    """Read a file, check its walks, and store those that pass (unless ``dry_run``).

    InvalidError names what of the file cannot be read; then nothing is stored. A walk that is refused stops no other.
    """
    services = context.services
    level = services.venues.get_level(services.surveys.get(survey_id).level_id)
    anchor = services.venues.get(level.venue_id).anchor
    findings = Findings()
    markers = {marker_key(one.name): (one.x, one.y) for one in services.recordings.markers(level.id)}
    choices = replace(choices, markers=markers)
    try:
        found = list(read_recording(content, kind, choices, None if anchor is None else anchor.plane(), findings))
    except InputError as error:
        raise refused(error) from error
    walks = [_take(context, survey_id, level, walk, frame, radio=radio, dry_run=dry_run) for walk in found]
    return SurveyImportOut(
        survey_id=survey_id,
        dry_run=dry_run,
        walks=walks,
        read=findings.read,
        assumed=findings.assumed,
        skipped=findings.skipped,
    )


def _take(
    context: Context, survey_id: str, level: Level, walk: SurveyWalk, frame: Frame, *, radio: bool, dry_run: bool
) -> ImportedWalkOut:
    name = _CONTROL.sub(" ", walk.walk_id).strip()[:_MAX_NAME] or "walk"
    try:
        upload = parse(walk_body(name, walk, radio=radio), MSGPACK, WalkIn, WALK_BOUNDS)
        new = new_walk(upload.model_copy(update={"frame": frame}), level.extent, context.clock())
    except RejectedError as error:
        reasons = [f"{one.field} {one.message}: {one.remedy}" for one in error.errors]
        return _report(name, walk, WalkFate.REFUSED, None, reasons)
    return _report(name, walk, *_stored(context, survey_id, new, dry_run=dry_run), [])


def _stored(context: Context, survey_id: str, new: NewWalk, *, dry_run: bool) -> tuple[WalkFate, Walk | None]:
    surveys = context.services.surveys
    if dry_run:
        known = surveys.find_walk(survey_id, new.content_hash)
        return WalkFate.NEW if known is None else WalkFate.KNOWN, known
    stored, repeated = surveys.add_walk(survey_id, new)
    return WalkFate.KNOWN if repeated else WalkFate.NEW, stored


def _report(name: str, walk: SurveyWalk, fate: WalkFate, stored: Walk | None, reasons: list[str]) -> ImportedWalkOut:
    t = walk.samples.t
    return ImportedWalkOut(
        name=name,
        fate=fate,
        walk_id=None if stored is None else stored.id,
        n_samples=len(walk.samples),
        n_waypoints=len(walk.waypoints),
        duration_s=round(float(t[-1] - t[0]), 3) if len(t) else 0.0,
        reasons=reasons,
        x=walk.waypoints.x.tolist(),
        y=walk.waypoints.y.tolist(),
    )


def pairs_of(parameter: str, texts: list[str]) -> dict[str, str]:
    """``name=value`` texts of a query as a mapping."""
    return dict(_pairs(parameter, texts))


def _pairs(parameter: str, texts: list[str]) -> Iterator[tuple[str, str]]:
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise RejectedError(
                [FieldError(parameter, f"{text[:80]!r} is no pair", "write it as in mag=nT, or mag_x=MagX")]
            )
        yield name.lower(), value
