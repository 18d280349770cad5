"""Tracks of sessions as files."""

from __future__ import annotations

from isodyn_client.calls import Call, as_bytes, present
from isodyn_client.models import FixKind


def track(session_id: str, *, format: str = "geojson", kind: FixKind | str | None = None) -> Call[bytes]:  # noqa: A002
    """All fixes of a session as a file: ``geojson``, ``mf-json``, ``gpx`` or ``csv``.

    ``kind`` is ``filtered`` (as told in the moment) unless another one is named. All formats but CSV are in WGS 84: the
    venue needs an anchor for them.
    """
    params = present({"format": format, "kind": None if kind is None else str(kind)})
    return Call("GET", f"/v1/sessions/{session_id}/track", as_bytes, params=params, wait_s=120.0)
