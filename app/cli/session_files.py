"""A recording as a session: opened, sent segment by segment, its positions printed."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import isodyn_client as isodyn
import typer

from app.cli.common import progress_bars
from app.cli.fix_table import columns_of, print_fixes
from app.cli.phone_files import Upload, read_recording, send
from app.exchange.phones.files import FileChoices, PhoneFormat
from app.exchange.surveys import Findings

if TYPE_CHECKING:
    from isodyn_client import Client


@dataclass(frozen=True, slots=True)
class Place:
    """Where and how to locate: a level or a venue, a prior, a method, a device."""

    level: str | None
    venue: str | None
    x: float | None = None
    y: float | None = None
    radius_m: float = 3.0
    heading_deg: float | None = None
    method: str | None = None
    device: str | None = None

    def is_anchored(self, client: Client) -> bool:
        """Whether latitude and longitude mean something there."""
        venue = self.venue if self.level is None else client.level(self.level).venue_id
        return venue is not None and client.venue(venue).anchor is not None

    def open(self, client: Client) -> isodyn.Session:
        """A session there."""
        known = self.x is not None or self.heading_deg is not None
        prior = isodyn.Prior(x=self.x, y=self.y, radius_m=self.radius_m, heading_deg=self.heading_deg)
        return client.open_session(
            self.level,
            venue_id=self.venue,
            method=self.method,
            prior=prior if known else None,
            device_id=self.device,
        )


def import_session(
    client: Client,
    file: Path,
    kind: PhoneFormat | None,
    choices: FileChoices,
    place: Place,
    *,
    segment_s: float,
    dry_run: bool,
    output: Path | None,
) -> None:
    """Locate a recording, and say what became of it."""
    findings = Findings()
    trip = read_recording(file, kind, choices, findings)
    upload = Upload.of(trip, anchored=place.is_anchored(client), findings=findings)
    findings.read.append(f"{file.name}: {upload.samples.duration_s:.0f} s, {len(upload.samples)} samples")
    n_segments = sum(1 for _ in upload.pieces(segment_s, findings))
    for line in findings.lines():
        typer.echo(line, err=not dry_run)
    if dry_run:
        typer.echo(f"{n_segments} segments; nothing is sent (--dry-run)")
        return
    with place.open(client) as session, progress_bars() as bars:
        typer.echo(session.id, err=True)
        bar = bars.add_task("locating", total=n_segments, text="")
        for result in send(session, upload, segment_s, Findings()):
            bars.update(bar, advance=1, text=f"segment {result.seq + 1} of {n_segments}")
        fixes = session.positions()
    if output is not None:
        output.write_text(json.dumps(columns_of(fixes)))
    print_fixes(fixes, float(upload.samples.t_ms[0]))
