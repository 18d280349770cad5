"""Every format of survey recordings behind one call, for whoever has a file's bytes."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from app.engine.geodesy import TangentPlane
from app.engine.types import SurveyWalk
from app.exchange.phones import files as phone_files
from app.exchange.phones.files import PhoneFormat
from app.exchange.phones.places import Markers
from app.exchange.phones.survey_walks import phone_walks
from app.exchange.surveys.archive import read_archive
from app.exchange.surveys.csv_file import CsvChoices, read_csv
from app.exchange.surveys.getsensordata import LogChoices, read_getsensordata
from app.exchange.surveys.recording import Findings


class SurveyFormat(StrEnum):
    """Formats that :func:`read_recording` takes."""

    ARCHIVE = "archive"
    CSV = "csv"
    GETSENSORDATA = "getsensordata"
    SENSOR_LOGGER = "sensor-logger"
    PHYPHOX = "phyphox"


PHONES = frozenset({SurveyFormat.SENSOR_LOGGER, SurveyFormat.PHYPHOX})


@dataclass(frozen=True, slots=True)
class FileChoices:
    """What the sender says of a file; see the readers for the meaning.

    Attributes
    ----------
    name : str
        Of the walks, where the file does not name them.
    floor : str or None
    start_s : float or None
        Unix seconds.
    columns, units : mapping
        Of CSV only.
    markers : mapping
        Of phones only: named places, as :mod:`app.exchange.phones.places` takes them.
    """

    name: str = "walk"
    floor: str | None = None
    start_s: float | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    markers: Markers = field(default_factory=dict)


def read_recording(
    content: bytes, kind: SurveyFormat, choices: FileChoices, plane: TangentPlane | None, findings: Findings
) -> Iterator[SurveyWalk]:
    """Walks of a file, each with its name as ``walk_id``.

    Parameters
    ----------
    content : bytes
    kind : SurveyFormat
    choices : FileChoices
    plane : TangentPlane or None
        Takes latitude and longitude to level metres.
    findings : Findings
        Is told what was read, assumed and left out.

    Raises
    ------
    InputError
        Names what of the file cannot be read, and the remedy.
    """
    source = io.BytesIO(content)
    if kind is SurveyFormat.ARCHIVE:
        return _of_archive(source, findings)
    if kind is SurveyFormat.CSV:
        of_csv = CsvChoices(choices.columns, choices.units, choices.floor, choices.start_s)
        return read_csv(source, choices.name, of_csv, plane, findings)
    if kind in PHONES:
        of_phone = phone_files.FileChoices(start_s=choices.start_s)
        return phone_walks(content, PhoneFormat(kind.value), choices.name, of_phone, choices.markers, findings)
    log = LogChoices(choices.floor, start_s=choices.start_s)
    return read_getsensordata(source, choices.name, log, plane, findings)


def _of_archive(source: io.BytesIO, findings: Findings) -> Iterator[SurveyWalk]:
    for name, walk in read_archive(source):
        findings.read.append(f"{name}: {len(walk.samples)} samples, {len(walk.waypoints)} positions")
        yield replace(walk, walk_id=name)
