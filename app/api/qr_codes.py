"""QR codes of addresses, for phones to read off a screen."""

from __future__ import annotations

import io

import segno

from app.services.ingest.records import IngestApp

_QUIET = 4
"""Modules of white around a code: readers need them."""


def qr_text(app: IngestApp, url: str) -> str:
    """What a code says: phyphox opens addresses that begin with its own name, other apps take them as they are."""
    if app is not IngestApp.PHYPHOX:
        return url
    return "phyphox:" + url.partition(":")[2]


def qr_svg(text: str) -> str:
    """The code as SVG, without a size of its own; medium error correction."""
    out = io.BytesIO()
    # white is drawn: on a dark page a code without ground cannot be read
    segno.make(text, error="m", micro=False).save(
        out, kind="svg", border=_QUIET, dark="#000", light="#fff", omitsize=True, xmldecl=False
    )
    return out.getvalue().decode().strip()
