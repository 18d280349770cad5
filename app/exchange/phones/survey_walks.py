"""Survey walks of a phone's recording: annotations are its waypoints."""

from __future__ import annotations

from collections.abc import Iterator

from app.engine.types import SurveyWalk
from app.exchange.phones.files import FileChoices, PhoneFormat, read_trip
from app.exchange.phones.places import Markers, waypoints_of
from app.exchange.surveys.recording import Findings, Recording, walks_of

_SHOWN = 5


def phone_walks(
    content: bytes, kind: PhoneFormat, name: str, choices: FileChoices, markers: Markers, findings: Findings
) -> Iterator[SurveyWalk]:
    """Walks of a file; annotations that name positions or markers are the waypoints.

    Parameters
    ----------
    content : bytes
    kind : PhoneFormat
    name : str
        Of the walks.
    choices : FileChoices
    markers : mapping
    findings : Findings
        Is told what was read, assumed and left out.

    Raises
    ------
    InputError
        Names what of the file cannot be read, and the remedy.
    """
    trip = read_trip(content, kind, choices, findings)
    samples = trip.assembled.samples
    waypoints, others = waypoints_of(trip.assembled.annotations, markers)
    if others:
        shown = ", ".join(repr(text[:40]) for text in others[:_SHOWN])
        more = f" and {len(others) - _SHOWN} more" if len(others) > _SHOWN else ""
        findings.skipped.append(f"annotations that name neither x,y nor a marker: {shown}{more}")
    if samples is not None:
        yield from walks_of(Recording(name, samples, waypoints), None, findings)
