"""Recordings of others on their way into a survey, and files on their way out of a service."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal

import isodyn_client as isodyn

from app.cli.convert import ble_of, samples_of, waypoints_of, wifi_of
from app.cli.errors import InputFileError
from app.cli.phone_files import PHONES, phone_walks
from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import SurveyWalk
from app.evaluation.errors import DataSetError
from app.exchange.phones import PhoneFrame
from app.exchange.phones.files import FileChoices as PhoneChoices
from app.exchange.phones.files import PhoneFormat
from app.exchange.surveys import CsvChoices, Findings, LogChoices, read_csv, read_getsensordata, read_survey

if TYPE_CHECKING:
    from isodyn_client import Client

_MAP_SUFFIXES = {
    ".nc": "netcdf", ".cdf": "netcdf", ".grd": "netcdf", ".tif": "geotiff", ".tiff": "geotiff", ".asc": "esri-ascii",
    ".xyz": "xyz", ".txt": "xyz", ".csv": "xyz", ".dat": "xyz",
}  # fmt: skip
_MAX_NAME = 200
_CONTROL = re.compile(r"[\x00-\x1f\x7f]+")


@dataclass(frozen=True, slots=True)
class Choices:
    """What the user says of the files."""

    format: str
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    floor: str | None = None
    start_s: float | None = None
    radio: bool = False
    split: Literal["train", "test"] | None = "train"
    markers: Path | None = None
    """Named places, for annotations of phones."""


class Importer:
    """Reads files and uploads their walks into one survey, one walk in memory at a time.

    Parameters
    ----------
    client : Client
    target : str
        Id of a survey, or of a level: then a survey of this ``name`` is used, or made with the first walk.
    choices : Choices
    name : str
    frame : str
        Axes of the sensors, as an upload names them.
    dry_run : bool
        Nothing is uploaded.
    """

    def __init__(
        self, client: Client, target: str, choices: Choices, name: str, *, frame: str = "android", dry_run: bool = False
    ) -> None:
        self._client, self._choices, self._frame, self._dry_run = client, choices, frame, dry_run
        self._name = name
        self.survey_id: str | None = None
        if target.startswith("srv_"):
            self.survey_id = client.survey(target).id
            self._level = client.level(client.survey(target).level_id)
        else:
            self._level = client.level(target)
            same = [one.id for one in client.surveys(level_id=self._level.id) if one.name == name]
            self.survey_id = same[-1] if same else None
        self._known = set() if self.survey_id is None else {one.id for one in client.walks(self.survey_id)}
        self.plane = _plane(client.venue(self._level.venue_id).anchor)
        self.lines: list[str] = []
        self.failed = False

    def take(self, file: Path) -> None:
        """Read a file, upload its walks, and note in words what became of it."""
        findings = Findings()
        self.lines.append(f"{file}:")
        uploaded = repeated = 0
        try:
            for walk in self._walks(file, findings):
                fresh = self._upload(walk, findings)
                uploaded += fresh is True
                repeated += fresh is False
        except (InputError, DataSetError) as error:
            self.failed = True
            findings.skipped.append(str(error))
        self.lines += [f"  {line}" for line in findings.lines()]
        done = "nothing is uploaded (--dry-run)" if self._dry_run else f"{uploaded} walks uploaded"
        self.lines.append(f"  {done}{f', {repeated} were there already' if repeated else ''}")

    def _walks(self, file: Path, findings: Findings) -> Iterator[SurveyWalk]:
        choices, name = self._choices, clean_name(file.stem)
        if choices.format == "dataset":
            yield from dataset_walks(file, choices.split, findings)
        elif choices.format == "isodyn":
            for title, walk in read_survey(file):
                findings.read.append(f"{title}: {len(walk.samples)} samples, {len(walk.waypoints)} positions")
                yield replace(walk, walk_id=title)
        elif choices.format == "csv":
            wanted = CsvChoices(choices.columns, choices.units, choices.floor, choices.start_s)
            with file.open("rb") as source:
                yield from read_csv(source, name, wanted, self.plane, findings)
        elif choices.format in PHONES:
            said = PhoneChoices(PhoneFrame(self._frame), choices.start_s, choices.radio)
            yield from phone_walks(file, PhoneFormat(choices.format), said, choices.markers, findings)
        else:
            log = LogChoices(choices.floor, choices.radio, choices.start_s)
            with file.open("rb") as source:
                yield from read_getsensordata(source, name, log, self.plane, findings)

    def _upload(self, walk: SurveyWalk, findings: Findings) -> bool | None:
        """Whether the walk is new to the survey; None if it was not uploaded."""
        if self._dry_run:
            return None
        if self.survey_id is None:
            self.survey_id = self._client.create_survey(self._level.id, self._name).id
        samples = samples_of(walk.samples)
        try:
            stored = self._client.add_walk(
                self.survey_id,
                clean_name(walk.walk_id),
                # what is read of phones is in Android's frame already
                samples if self._choices.format in PHONES else replace(samples, frame=self._frame),
                waypoints_of(walk.waypoints),
                wifi=wifi_of(walk.wifi) if self._choices.radio else None,
                ble=ble_of(walk.ble) if self._choices.radio else None,
            )
        except isodyn.InvalidRequestError as error:
            self.failed = True
            findings.skipped.append(f"{walk.walk_id}: refused: {error}")
            return None
        fresh = stored.id not in self._known
        self._known.add(stored.id)
        return fresh


def _plane(anchor: isodyn.Anchor | None) -> TangentPlane | None:
    if anchor is None:
        return None
    return TangentPlane(anchor.latitude_deg, anchor.longitude_deg, anchor.bearing_deg, anchor.height_m)


def dataset_walks(folder: Path, split: Literal["train", "test"] | None, findings: Findings) -> Iterator[SurveyWalk]:
    """Walks of a data-set folder, of whichever layout it has."""
    from app.cli.uploads import choose_walks, open_level
    from app.evaluation.datasets.columns import read_json
    from app.evaluation.datasets.kaist import SURVEY, TEST, KaistFloor

    level = open_level(folder)
    if "walkable" in read_json(folder / "floor.json"):
        floor = KaistFloor(level.name, folder)
        kinds = {"train": (SURVEY,), "test": (TEST,)}.get(split or "", (SURVEY, TEST))
        recorded = [walk for kind in kinds for walk in floor.walks(kind)]
        findings.assume("the direction in which the phone was held is not kept: it is estimated when a map is built")
    else:
        recorded = choose_walks(level, split, (), None)
    for one in recorded:
        walk = one.survey_walk()
        findings.read.append(f"{one.walk_id}: {len(walk.samples)} samples, {len(walk.waypoints)} positions")
        yield walk


def guess_map_format(file: Path) -> str:
    """Format of a map by its file's name, and by what is in it if that is a zip file."""
    suffix = file.suffix.lower()
    if suffix in _MAP_SUFFIXES:
        return _MAP_SUFFIXES[suffix]
    if suffix == ".zip":
        for inner in _names(file):
            if (kind := _MAP_SUFFIXES.get(PurePosixPath(inner).suffix.lower())) in {"geotiff", "esri-ascii"}:
                return kind
    raise InputFileError(file, "does not tell its format; name it with --format")


def _names(file: Path) -> list[str]:
    try:
        with zipfile.ZipFile(file) as archive:
            return archive.namelist()
    except zipfile.BadZipFile as error:
        raise InputFileError(file, "is no zip file") from error


def unpack(content: bytes, folder: Path) -> None:
    """Write the files of a survey archive into a folder; names that lead elsewhere are refused."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for name in archive.namelist():
            if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                raise InputFileError(folder, f"the archive holds a file outside itself: {name!r}")
        folder.mkdir(parents=True, exist_ok=True)
        archive.extractall(folder)


def pairs_of(option: str, texts: Iterable[str]) -> dict[str, str]:
    """``name=value`` texts as a mapping."""
    pairs = [text.partition("=") for text in texts]
    for name, equals, value in pairs:
        if not (equals and name.strip() and value.strip()):
            raise InputError(option, f"{name!r} is no pair; write it as in --{option} mag_x=MagX")
    return {name.strip().lower(): value.strip() for name, _, value in pairs}


def start_of(text: str) -> float:
    """Unix seconds of an ISO 8601 time; UTC unless it says otherwise."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError("start", f"{text!r} is no time; write it as in 2026-11-22T09:30:00Z") from error
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def anchor_of(text: str) -> TangentPlane:
    """Anchor of ``LAT,LON[,BEARING]``."""
    remedy = "write it as in 48.1507,11.5691 or 48.1507,11.5691,12.5"
    try:
        numbers: Sequence[float] = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError("anchor", f"{text!r} is no place; {remedy}") from error
    if len(numbers) not in {2, 3} or not (-90 <= numbers[0] <= 90 and -180 <= numbers[1] <= 180):
        raise InputError("anchor", f"{text!r} is no place; {remedy}")
    return TangentPlane(*numbers)


def clean_name(name: str) -> str:
    """A name that the service takes."""
    return _CONTROL.sub(" ", name).strip()[:_MAX_NAME] or "walk"
