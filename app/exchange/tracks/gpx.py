"""Tracks as GPX 1.1 (https://www.topografix.com/GPX/1/1/gpx.xsd): a track a level, a segment a stretch.

GPX has no way to say that a position is in doubt, so fixes that claim none are left out and end their segment. The
elements of the schema are sequences: their order is fixed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from xml.sax.saxutils import escape, quoteattr

from app.engine.geodesy import TangentPlane
from app.exchange.tracks.document import (
    Stretch,
    TrackDocument,
    TrackPoint,
    degrees_of,
    iso_time,
    plane_of,
    spread_of,
    stretches,
)

NAMESPACE = "https://isodyn.dev/ns/track/1"
RANGE_ERROR_M = 5.0
"""Error of one range that readers of ``hdop`` commonly multiply it with; ``hdop`` here is rms error / 5 m."""
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_gpx(document: TrackDocument, points: Iterable[TrackPoint]) -> Iterator[bytes]:
    """A GPX file, piece by piece."""
    plane = plane_of(document)
    yield _head(document).encode()
    level_id: str | None = None
    for stretch in stretches(points):
        if stretch.level_id != level_id:
            if level_id is not None:
                yield b"</trk>\n"
            level_id = stretch.level_id
            yield _track_head(document, level_id).encode()
        yield _segment(stretch, plane).encode()
    yield b"</trk>\n</gpx>\n" if level_id is not None else b"</gpx>\n"


def _head(document: TrackDocument) -> str:
    about = (
        f"{document.kind.value} fixes of session {document.session_id}, method {document.method}; fixes that claim no "
        f"position are left out"
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<gpx version="1.1" creator={quoteattr(_xml(document.software))} xmlns="http://www.topografix.com/GPX/1/1" '
        f'xmlns:isodyn="{NAMESPACE}">\n'
        f"<metadata><name>{escape(_xml(document.venue))}</name><desc>{escape(_xml(about))}</desc></metadata>\n"
    )


def _track_head(document: TrackDocument, level_id: str) -> str:
    name = f"{document.venue}, {document.level_name(level_id)}"
    return f"<trk><name>{escape(_xml(name))}</name><src>{escape(document.software)}</src><type>magnetic</type>\n"


def _segment(stretch: Stretch, plane: TangentPlane) -> str:
    lines = "".join(_point(point, plane) for point in stretch.points)
    return f"<trkseg>\n{lines}</trkseg>\n"


def _point(point: TrackPoint, plane: TangentPlane) -> str:
    longitude, latitude = degrees_of(point.fix, plane)
    spread = spread_of(point.fix)
    rms = (spread.major_m**2 + spread.minor_m**2) ** 0.5
    return (
        f'<trkpt lat="{latitude:.8f}" lon="{longitude:.8f}"><time>{iso_time(point.fix.t)}</time>'
        f"<hdop>{rms / RANGE_ERROR_M:.2f}</hdop><extensions>"
        f"<isodyn:sd_major_m>{spread.major_m:.3f}</isodyn:sd_major_m>"
        f"<isodyn:sd_minor_m>{spread.minor_m:.3f}</isodyn:sd_minor_m>"
        f"<isodyn:sd_azimuth_deg>{spread.azimuth_deg(plane):.1f}</isodyn:sd_azimuth_deg>"
        f"<isodyn:sure>{'true' if point.fix.sure else 'false'}</isodyn:sure>"
        "</extensions></trkpt>\n"
    )


def _xml(text: str) -> str:
    """Without the characters that no XML document may hold."""
    return _NOT_XML.sub(" ", text)
