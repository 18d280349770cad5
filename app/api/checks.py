"""The checks of uploads for what comes in by other ways: what a phone pushes passes the same as a client's segment."""

from __future__ import annotations

from datetime import datetime

from app.api.errors import RejectedError
from app.api.plausibility import SEGMENT_LIMITS, WALK_LIMITS, UploadLimits, check_samples
from app.api.schemas.samples import SamplesIn, VectorIn, WaypointsIn
from app.api.uploads import content_hash
from app.api.waypoints import Extent, check_waypoints
from app.engine.types import Float64Array, ImuSamples, SurveyWalk
from app.services.aids import NO_AIDS, Aids
from app.services.errors import InvalidError
from app.services.records import NewSegment, NewWalk


class Checks:
    """Port ``UploadChecks``."""

    def segment(self, seq: int, samples: ImuSamples, aids: Aids, now: datetime) -> NewSegment:
        """A segment; InvalidError if no phone can have read that."""
        _check(samples, SEGMENT_LIMITS, now)
        return NewSegment(seq, samples, content_hash(samples, aids), aids)

    def walk(self, walk: SurveyWalk, device_id: str, extent: Extent, now: datetime) -> NewWalk:
        """A survey walk on a level of this extent; InvalidError likewise."""
        _check(walk.samples, WALK_LIMITS, now)
        points = walk.waypoints
        waypoints = WaypointsIn.model_construct(t_ms=points.t * 1000.0, x=points.x, y=points.y)
        try:
            check_waypoints(waypoints, walk.samples.t * 1000.0, extent)
        except RejectedError as error:
            raise _invalid(error) from error
        digest = content_hash(walk.samples, NO_AIDS, points)
        return NewWalk(walk.walk_id, walk.samples, points, digest, device_id=device_id)


def _check(samples: ImuSamples, limits: UploadLimits, now: datetime) -> None:
    shown = SamplesIn.model_construct(
        t_ms=samples.t * 1000.0, mag=_vector(samples.mag), acc=_vector(samples.acc), gyro=_vector(samples.gyro)
    )
    try:
        check_samples(shown, limits, now)
    except RejectedError as error:
        raise _invalid(error) from error


def _vector(rows: Float64Array) -> VectorIn:
    return VectorIn.model_construct(x=rows[:, 0], y=rows[:, 1], z=rows[:, 2])


def _invalid(error: RejectedError) -> InvalidError:
    first = error.errors[0]
    return InvalidError(first.field.removeprefix("samples."), first.message, first.remedy)
