"""Files of survey recordings, read by the service."""

from __future__ import annotations

from collections.abc import Mapping

from isodyn_client.calls import Call, as_model, present
from isodyn_client.encoding import raw_body
from isodyn_client.models import Model


class ImportedWalk(Model):
    """A walk that was found in a file; ``fate`` is "new", "known" or "refused" (then ``reasons`` say why)."""

    name: str
    fate: str
    walk_id: str | None
    n_samples: int
    n_waypoints: int
    duration_s: float
    reasons: tuple[str, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]


class SurveyImport(Model):
    """What was read of a file, what was assumed, and what was left out and why."""

    survey_id: str
    dry_run: bool
    walks: tuple[ImportedWalk, ...]
    read: tuple[str, ...]
    assumed: tuple[str, ...]
    skipped: tuple[str, ...]


def import_survey(
    survey_id: str,
    content: bytes,
    *,
    format: str,  # noqa: A002
    name: str | None = None,
    floor: str | None = None,
    start: str | None = None,
    column: Mapping[str, str] | None = None,
    unit: Mapping[str, str] | None = None,
    frame: str | None = None,
    radio: bool = False,
    dry_run: bool = False,
) -> Call[SurveyImport]:
    """Read the walks of a file (``archive``, ``csv``, ``getsensordata``) into a survey, or only report on it.

    ``column`` and ``unit`` say of a CSV file what its header does not: ``{"mag_x": "MagX"}``, ``{"mag": "nT"}``. A walk
    that is there already stays one, so the call may be repeated.
    """
    params = present(
        {
            "format": format,
            "name": name,
            "floor": floor,
            "start": start,
            "column": _pairs(column),
            "unit": _pairs(unit),
            "frame": frame,
            "radio": "true" if radio else None,
            "dry_run": "true" if dry_run else None,
        }
    )
    body = raw_body(content, "application/octet-stream", gzip=True)
    path = f"/v1/surveys/{survey_id}/import"
    return Call("POST", path, as_model(SurveyImport), params=params, body=body, wait_s=120.0)


def _pairs(values: Mapping[str, str] | None) -> list[str] | None:
    return [f"{name}={value}" for name, value in values.items()] if values else None
