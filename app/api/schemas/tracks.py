"""Example of a track file, for the document."""

from __future__ import annotations

from typing import Any

TRACK_EXAMPLE: dict[str, Any] = {
    "type": "FeatureCollection",
    "properties": {"session_id": "ses_019ab2c4d1e07f3a9b2c4d5e6f", "kind": "filtered", "venue": "Central Mall"},
    "features": [
        {
            "type": "Feature",
            "id": 0,
            "geometry": {"type": "Point", "coordinates": [11.56925814, 48.15073659]},
            "properties": {
                "part": "fix",
                "seq": 0,
                "time": "2026-11-30T09:00:04.980Z",
                "kind": "filtered",
                "level_id": "lvl_019ab2c4d1e07f3a9b2c4d5e6f",
                "x": 12.31,
                "y": 4.07,
                "sd_major_m": 1.185,
                "sd_minor_m": 0.703,
                "sd_azimuth_deg": 72.5,
                "status": "ok",
                "sure": True,
                "quality": 0.83,
            },
        }
    ],
}
