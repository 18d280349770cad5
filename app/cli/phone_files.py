"""Recordings of phones on their way into a service: as survey walks, or as a session."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import isodyn_client as isodyn
import numpy as np

from app.cli.convert import ble_of, samples_of, to_ms, wifi_of
from app.cli.errors import InputFileError
from app.engine.errors import InputError
from app.engine.types import SurveyWalk
from app.exchange.phones.files import FileChoices, PhoneFormat, Trip, format_of, read_trip
from app.exchange.phones.places import read_markers
from app.exchange.phones.survey_walks import phone_walks as survey_walks
from app.exchange.surveys import Findings
from app.exchange.surveys.recording import MAX_GAP_S, MIN_RATE_HZ

if TYPE_CHECKING:
    from isodyn_client import Session

PHONES = frozenset({PhoneFormat.SENSOR_LOGGER.value, PhoneFormat.PHYPHOX.value})
"""Formats of surveys that are read here; GetSensorData has positions of its own."""
MAX_FILE = 512 * 2**20
WAIT_S = 30.0


def phone_walks(
    file: Path, kind: PhoneFormat, choices: FileChoices, markers: Path | None, findings: Findings
) -> Iterator[SurveyWalk]:
    """Survey walks of a recording: annotations that name positions or markers are its waypoints."""
    from app.cli.survey_files import clean_name

    known = {} if markers is None else read_markers(_content(markers))
    yield from survey_walks(_content(file), kind, clean_name(file.stem), choices, known, findings)


def _content(file: Path) -> bytes:
    if file.stat().st_size > MAX_FILE:
        raise InputFileError(file, f"has more than {MAX_FILE} bytes; split the recording")
    return file.read_bytes()


def read_recording(file: Path, kind: PhoneFormat | None, choices: FileChoices, findings: Findings) -> Trip:
    """A recording of whichever format it is, or of that named."""
    content = _content(file)
    return read_trip(content, kind or format_of(content), choices, findings)


@dataclass(frozen=True, slots=True)
class Upload:
    """A recording as a session takes it."""

    samples: isodyn.Samples
    aids: isodyn.Aids

    @classmethod
    def of(cls, trip: Trip, *, anchored: bool, findings: Findings) -> Upload:
        """Of a trip; satellite fixes stay behind where the venue has no anchor."""
        part = trip.assembled
        if part.samples is None:
            raise InputError("file", "has no samples; record all sensors")
        gnss, pressure, steps = part.gnss, part.pressure, part.steps
        if gnss is not None and not anchored:
            findings.skipped.append(f"{len(gnss.t)} satellite fixes: the venue has no anchor")
            gnss = None
        aids = isodyn.Aids(
            wifi=wifi_of(trip.wifi),
            ble=ble_of(trip.ble),
            gnss=None
            if gnss is None
            else isodyn.GnssFixes(to_ms(gnss.t), gnss.latitude_deg, gnss.longitude_deg, gnss.accuracy_m),
            pressure=None if pressure is None else isodyn.PressureReadings(to_ms(pressure.t), pressure.hpa),
            steps=None if steps is None else isodyn.StepCounts(to_ms(steps.t), steps.count),
        )
        return cls(samples_of(part.samples), aids)

    def pieces(self, segment_s: float, findings: Findings) -> Iterator[tuple[isodyn.Samples, isodyn.Aids]]:
        """Segments that the service takes: without gaps, and dense enough to show steps."""
        t_ms = self.samples.t_ms
        bounds = [0, *(np.flatnonzero(np.diff(t_ms) > MAX_GAP_S * 1000.0) + 1).tolist(), len(t_ms)]
        after, sparse = -np.inf, 0
        for start, stop in itertools.pairwise(bounds):
            for piece in self.samples[start:stop].split(segment_s):
                if len(piece) > 1 and float(np.median(np.diff(piece.t_ms))) > 1000.0 / MIN_RATE_HZ:
                    sparse += len(piece)
                    continue
                until = float(piece.t_ms[-1]) + 1.0
                yield piece, self.aids.heard(after, float(piece.t_ms[0]), until)
                after = until
        if len(bounds) > 2:
            findings.skipped.append(f"{len(bounds) - 2} gaps of more than {MAX_GAP_S:g} s: a new segment begins there")
        if sparse:
            findings.skipped.append(f"{sparse} samples further apart than {1 / MIN_RATE_HZ:g} s: they show no steps")


def send(session: Session, upload: Upload, segment_s: float, findings: Findings) -> Iterator[isodyn.SegmentResult]:
    """Send a recording segment by segment; when it is through, all segments are processed."""
    last: int | None = None
    for piece, aids in upload.pieces(segment_s, findings):
        result = session.send(piece, aids=aids, wait=WAIT_S)
        last = result.seq
        yield result
    if last is not None:
        session.wait_for(last)
