"""Survey archives: a zip of ``survey.json`` and one msgpack file a walk, each the body that ``POST .../walks`` takes.

Device ids stay behind (what is known about a device is not part of a survey), and radio readings too unless they are
asked for: addresses identify people's phones and homes.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, Protocol, cast

import msgpack
import numpy as np

from app.engine.errors import InputError
from app.engine.types import Float64Array, ImuSamples, RadioScans, SurveyWalk, Waypoints
from app.exchange.maps.archive import DAMAGED_ZIP

FORMAT, VERSION = "isodyn-survey", 1
HEAD = "survey.json"
WALKS = "walks/"
_SUFFIX = ".msgpack"
_EPOCH = (1980, 1, 1, 0, 0, 0)
_AXES = ("x", "y", "z")
_SENSORS = ("mag", "acc", "gyro")
MAX_WALK_BYTES = 64 * 2**20
"""Of one walk's file: 200,000 samples take 9 MB."""


def walk_body(name: str, walk: SurveyWalk, *, radio: bool) -> bytes:
    """A walk as the API takes it: times in Unix milliseconds, to the microsecond."""
    body: dict[str, Any] = {
        "name": name,
        "frame": "android",
        "samples": {"t_ms": _ms(walk.samples.t), **{one: _triple(getattr(walk.samples, one)) for one in _SENSORS}},
        "waypoints": {
            "t_ms": _ms(walk.waypoints.t),
            "x": walk.waypoints.x.astype("<f8").tobytes(),
            "y": walk.waypoints.y.astype("<f8").tobytes(),
        },
    }
    if radio:
        for aid, address in (("wifi", "bssid"), ("ble", "address")):
            scans: RadioScans | None = getattr(walk, aid)
            if scans is not None:
                rssi = np.asarray(scans.rssi, "<f4").tobytes()
                body[aid] = {"t_ms": _ms(scans.t), address: list(scans.address), "rssi": rssi}
    packed: bytes = msgpack.packb(body)
    return packed


def _ms(t: Float64Array) -> bytes:
    return np.round(t * 1000.0, 3).astype("<f8").tobytes()


def _triple(rows: Float64Array) -> dict[str, bytes]:
    return {axis: rows[:, i].astype("<f4").tobytes() for i, axis in enumerate(_AXES)}


class _Sink:
    """Takes what a zip file writes, without a place to go back to."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def write(self, data: bytes) -> int:
        self._parts.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """Nothing waits here."""

    def taken(self) -> bytes:
        """What came since the last call."""
        content = b"".join(self._parts)
        self._parts.clear()
        return content


def survey_archive(
    head: Mapping[str, object], walks: Iterable[tuple[str, SurveyWalk]], *, radio: bool
) -> Iterator[bytes]:
    """Pieces of an archive, one a walk: only one walk is in memory at a time.

    Parameters
    ----------
    head : mapping
        What ``survey.json`` says besides format and version.
    walks : iterable of (name, SurveyWalk)
    radio : bool
        Whether Wi-Fi and BLE readings go along.
    """
    sink = _Sink()
    with zipfile.ZipFile(cast(IO[bytes], sink), "w", zipfile.ZIP_DEFLATED) as archive:
        content = {"format": FORMAT, "format_version": VERSION, **head, "radio": radio}
        archive.writestr(_entry(HEAD), json.dumps(content, indent=2, ensure_ascii=False))
        yield sink.taken()
        for number, (name, walk) in enumerate(walks, start=1):
            # float32 sensor noise hardly packs; level 1 is fast
            archive.writestr(
                _entry(f"{WALKS}{number:04d}{_SUFFIX}"), walk_body(name, walk, radio=radio), compresslevel=1
            )
            yield sink.taken()
    yield sink.taken()


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = 0o644 << 16
    return entry


class Source(Protocol):
    """An archive that is a zip file or the folder it was unpacked into."""

    def names(self) -> list[str]:
        """Files, sorted."""
        ...

    def read(self, name: str) -> bytes:
        """A file of at most 64 MiB."""
        ...


def read_survey(path: Path) -> Iterator[tuple[str, SurveyWalk]]:
    """Walks of an archive or of the folder it was unpacked into, one after the other, each with its name.

    Raises
    ------
    InputError
        Not an archive of a survey, or a walk that cannot be read: names the file and the field.
    """
    if path.is_dir():
        yield from _walks_of(_Folder(path))
        return
    try:
        file = path.open("rb")
    except OSError as error:
        raise InputError(str(path), f"cannot be opened ({error.strerror}); name another file") from error
    with file:
        yield from read_archive(file, str(path))


def read_archive(source: IO[bytes], file: str = "file") -> Iterator[tuple[str, SurveyWalk]]:
    """Walks of an archive that is open already; ``file`` is its name in errors.

    Raises
    ------
    InputError
        As of :func:`read_survey`.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            yield from _walks_of(_Zip(archive))
    except DAMAGED_ZIP as error:
        if isinstance(error, InputError):
            raise
        raise InputError(file, f"is no readable zip file ({str(error)[:80]}); export the survey again") from error


class _Folder:
    def __init__(self, path: Path) -> None:
        self._path = path

    def names(self) -> list[str]:
        return sorted(str(one.relative_to(self._path).as_posix()) for one in self._path.glob("**/*") if one.is_file())

    def read(self, name: str) -> bytes:
        path = self._path / name
        _check_size(name, path.stat().st_size)
        return path.read_bytes()


class _Zip:
    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive

    def names(self) -> list[str]:
        return sorted(self._archive.namelist())

    def read(self, name: str) -> bytes:
        size = self._archive.getinfo(name).file_size
        _check_size(name, size)
        with self._archive.open(name) as source:
            return source.read(size)


def _check_size(name: str, size: int) -> None:
    if size > MAX_WALK_BYTES:
        raise InputError(name, f"has {size} bytes; a walk has at most {MAX_WALK_BYTES}")


def _walks_of(source: Source) -> Iterator[tuple[str, SurveyWalk]]:
    names = source.names()
    if HEAD not in names:
        raise InputError(HEAD, "is missing; name an archive made by `isodyn survey export`")
    try:
        head = json.loads(source.read(HEAD))
    except (ValueError, RecursionError) as error:
        raise InputError(HEAD, "is not JSON; export the survey again") from error
    if not isinstance(head, dict) or head.get("format") != FORMAT or head.get("format_version") != VERSION:
        raise InputError(HEAD, f"does not say format {FORMAT!r}, version {VERSION}; export the survey again")
    for name in names:
        if name.startswith(WALKS) and name.endswith(_SUFFIX):
            yield read_walk(source.read(name), name)


def read_walk(content: bytes, file: str) -> tuple[str, SurveyWalk]:
    """One walk's file: its name and samples.

    Raises
    ------
    InputError
        Names file and field.
    """
    try:
        body = msgpack.unpackb(content)
    except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise InputError(file, f"is not msgpack ({str(error)[:80]}); export the survey again") from error
    if not isinstance(body, dict):
        raise InputError(file, "holds no walk; export the survey again")
    samples, waypoints = (_mapping(body, name, file) for name in ("samples", "waypoints"))
    t = _column(samples, "t_ms", "<f8", file) / 1000.0
    sensors = {}
    for sensor in _SENSORS:
        axes = _mapping(samples, sensor, file)
        columns = [_column(axes, axis, "<f4", f"{file}: {sensor}") for axis in _AXES]
        if any(len(one) != len(t) for one in columns):
            raise InputError(f"{file}: {sensor}", f"has not one value a sample ({len(t)}); export the survey again")
        sensors[sensor] = np.stack(columns, axis=1)
    points = [_column(waypoints, name, "<f8", f"{file}: waypoints") for name in ("t_ms", "x", "y")]
    if len({len(one) for one in points}) != 1:
        raise InputError(f"{file}: waypoints", "has columns of different lengths; export the survey again")
    name = str(body.get("name") or file)
    walk = SurveyWalk(
        walk_id=name,
        samples=ImuSamples(t=t, **sensors),
        waypoints=Waypoints(points[0] / 1000.0, points[1], points[2]),
        wifi=_scans(body, "wifi", "bssid", file),
        ble=_scans(body, "ble", "address", file),
    )
    return name, walk


def _mapping(parent: Mapping[str, Any], name: str, file: str) -> Mapping[str, Any]:
    value = parent.get(name)
    if not isinstance(value, dict):
        raise InputError(f"{file}: {name}", "is missing; export the survey again")
    return value


def _column(parent: Mapping[str, Any], name: str, kind: str, file: str) -> Float64Array:
    value = parent.get(name)
    if not isinstance(value, bytes) or len(value) % np.dtype(kind).itemsize:
        raise InputError(f"{file}: {name}", f"is no column of {np.dtype(kind).name}; export the survey again")
    column: Float64Array = np.frombuffer(value, kind).astype(np.float64)
    if not np.isfinite(column).all():
        raise InputError(f"{file}: {name}", "is not finite; leave samples without a reading out")
    return column


def _scans(body: Mapping[str, Any], name: str, address: str, file: str) -> RadioScans | None:
    if name not in body:
        return None
    part = _mapping(body, name, file)
    t, rssi = _column(part, "t_ms", "<f8", f"{file}: {name}"), _column(part, "rssi", "<f4", f"{file}: {name}")
    addresses = part.get(address)
    if not isinstance(addresses, list) or not len(addresses) == len(t) == len(rssi):
        raise InputError(f"{file}: {name}", "has columns of different lengths; export the survey again")
    return RadioScans(t / 1000.0, tuple(map(str, addresses)), rssi)
