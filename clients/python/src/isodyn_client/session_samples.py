"""What a session sent: raw samples, and the field along its track."""

from __future__ import annotations

from isodyn_client.calls import Call, as_bytes, as_model, present
from isodyn_client.models import Calibration, Model


class Channels(Model):
    """A column a component, uT: intensity, horizontal magnitude, vertical component (up); None: not known there."""

    total: tuple[float | None, ...]
    h: tuple[float | None, ...]
    v: tuple[float | None, ...]


class MeasuredProfile(Model):
    """Measured and mapped field at the fixes ``number`` of a session; ``calibration`` is taken off the former."""

    session_id: str
    number: tuple[int, ...]
    t_ms: tuple[float, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    level_id: tuple[str, ...]
    measured: Channels
    mapped: Channels
    sd: Channels
    calibration: Calibration | None = None
    learned: bool


def session_samples(
    session_id: str,
    *,
    format: str = "csv",  # noqa: A002
    after: int | None = None,
    last: int | None = None,
) -> Call[bytes]:
    """Raw samples of a session as a file, ``csv`` or ``msgpack``; of segments above ``after``, up to ``last`` only."""
    params = present({"format": format, "after": after, "last": last})
    return Call("GET", f"/v1/sessions/{session_id}/samples", as_bytes, params=params, wait_s=120.0)


def measured_profile(session_id: str) -> Call[MeasuredProfile]:
    """The field at each position of the session's last half hour, beside what its map says there."""
    return Call("GET", f"/v1/sessions/{session_id}/profile", as_model(MeasuredProfile), wait_s=60.0)
