"""Annotations of a recording that is located: marked points passed on the way tell how good the positions are."""

from __future__ import annotations

from datetime import datetime

from app.engine.localization.marks import Mark
from app.services.ground_truth import MAX_POINTS, settle
from app.services.ingest.records import IngestToken, RecordingInfo
from app.services.ingest.surveying import resolve
from app.services.ports import UnitOfWork


def keep_truth(uow: UnitOfWork, token: IngestToken, recording: RecordingInfo, now: datetime) -> None:
    """Note where the phone was, by its annotations, as ground truth of the session; what names no place is ignored."""
    if token.level_id is None or recording.session_id is None or not recording.annotations:
        return
    points, _ = resolve(recording.annotations, uow.ingest.markers(token.level_id))
    x_min, y_min, x_max, y_max = uow.levels.get(token.level_id).extent
    marks = [
        Mark(float(t), float(x), float(y), token.level_id)
        for t, x, y in zip(points.t, points.x, points.y, strict=True)
        if x_min <= x <= x_max and y_min <= y <= y_max
    ][:MAX_POINTS]
    if marks:
        uow.ground_truth.add(recording.session_id, marks, now)
        settle(uow, recording.session_id)
