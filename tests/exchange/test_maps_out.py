"""Maps as files: nothing is lost, other programs' readers agree, and nothing goes out that identifies a phone."""

from __future__ import annotations

import io
import json
import math
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.io import netcdf_file

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import FeatureSet
from app.exchange.maps import MapFormat
from app.exchange.maps.formats import MAX_TEXT_NODES
from tests.exchange.documents import PLANE, document, read, same, written
from tests.support.builders import radio_map

ADDRESSES = tuple(f"a4:2b:8c:91:{i:02x}:f7" for i in range(5))
ANCHORS = [None, PLANE, TangentPlane(-33.9, 151.2)]


@pytest.mark.parametrize("kind", MapFormat)
@pytest.mark.parametrize("features", FeatureSet)
@pytest.mark.parametrize("plane", ANCHORS)
def test_a_map_comes_back_as_it_went(kind: MapFormat, features: FeatureSet, plane: TangentPlane | None) -> None:
    made = document(features, plane=plane)
    back = read(written(made, kind), kind)
    assert same(back.grid, made.grid)
    assert np.array_equal(back.grid.obstacle, made.grid.obstacle)  # type: ignore[arg-type]
    assert (back.grid.radio, back.grid.routes) == (None, None)
    assert (back.field_sd, back.length_scale_m, back.assumed) == (made.field_sd, made.length_scale_m, ())
    assert back.attributes["title"] == made.title
    assert back.attributes["licence"] == made.licence


@pytest.mark.parametrize("kind", MapFormat)
def test_equal_maps_give_equal_bytes(kind: MapFormat) -> None:
    assert written(document(), kind) == written(document(), kind)


@pytest.mark.parametrize("kind", MapFormat)
def test_no_file_holds_addresses_or_lines(kind: MapFormat) -> None:
    made = document()
    radio = replace(radio_map(), addresses=ADDRESSES)
    content = written(replace(made, grid=replace(made.grid, radio=radio)), kind)
    if content.startswith(b"PK"):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            content += b"".join(archive.read(name) for name in archive.namelist())
    for address in ADDRESSES:
        assert address.encode() not in content
        assert bytes.fromhex(address.replace(":", "")) not in content


def test_netcdf_reads_in_scipy_and_follows_cf() -> None:
    made = document()
    with netcdf_file(io.BytesIO(written(made, MapFormat.NETCDF)), "r", mmap=False) as file:
        assert file.Conventions == b"CF-1.11"
        for name in ("title", "history", "licence", "content_hash", "feature_set", "software"):
            assert getattr(file, name), name
        assert file.title.decode() == made.title
        assert np.allclose(file.noise_sd, made.grid.noise_sd, rtol=0, atol=0)
        for axis in "xy":
            assert (file.variables[axis].units, file.variables[axis].axis) == (b"m", axis.upper().encode())
        assert file.variables["x"][1] - file.variables["x"][0] == made.grid.cell_m
        for i, channel in enumerate("xyz"):
            mean = file.variables[f"mean_{channel}"]
            assert (mean.dimensions, mean.units, mean.grid_mapping) == (("y", "x"), b"uT", b"crs")
            assert mean.long_name
            assert np.array_equal(mean[:], made.grid.mean[i])
            assert np.array_equal(file.variables[f"sd_{channel}"][:], made.grid.sd[i])
        assert file.variables["crs"].grid_mapping_name == b"latitude_longitude"
        assert float(file.variables["crs"].semi_major_axis) == 6378137.0
        lon, lat = (file.variables[name] for name in ("longitude", "latitude"))
        assert (lat.standard_name, lat.units) == (b"latitude", b"degrees_north")
        there = PLANE.to_wgs84(made.grid.x0 + 5 * made.grid.cell_m, made.grid.y0 + 3 * made.grid.cell_m)
        assert (lon[3, 5], lat[3, 5]) == pytest.approx(there, abs=1e-12)


def test_without_an_anchor_a_file_has_no_place_on_earth() -> None:
    with netcdf_file(io.BytesIO(written(document(plane=None), MapFormat.NETCDF)), "r", mmap=False) as file:
        assert not {"crs", "longitude", "latitude"} & set(file.variables)
        assert not hasattr(file.variables["mean_x"], "grid_mapping")


def tiff(content: bytes, name: str) -> tuple[np.ndarray, dict[int, object]]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive, Image.open(io.BytesIO(archive.read(name))) as image:
        return np.asarray(image), dict(image.tag_v2)  # type: ignore[attr-defined]


def test_geotiff_reads_in_pillow_north_up() -> None:
    made = document(plane=None)
    pixels, tags = tiff(written(made, MapFormat.GEOTIFF), "sd_z.tif")
    assert pixels.dtype == np.float32
    assert np.array_equal(pixels[::-1], made.grid.sd[2])
    top = made.grid.y0 + (made.grid.shape[0] - 1) * made.grid.cell_m
    assert tags[33550] == (made.grid.cell_m, made.grid.cell_m, 0.0)
    assert tags[33922] == (0.0, 0.0, 0.0, made.grid.x0, top, 0.0)


def transverse_mercator(lon: float, lat: float, origin: tuple[float, float], scale: float) -> tuple[float, float]:
    """East and north, m (Snyder, Map Projections: A Working Manual, eq. 8-9 and 8-10, to the fourth order)."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    lon0, lat0 = map(math.radians, origin)
    phi, step = math.radians(lat), (math.radians(lon) - lon0) * math.cos(math.radians(lat))
    n = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    t, c = math.tan(phi) ** 2, e2 / (1 - e2) * math.cos(phi) ** 2
    arc = np.linspace(lat0, phi, 20_001)
    meridian = np.trapezoid(a * (1 - e2) / (1 - e2 * np.sin(arc) ** 2) ** 1.5, arc)
    east = scale * n * (step + (1 - t + c) * step**3 / 6)
    north = scale * (meridian + n * math.tan(phi) * (step**2 / 2 + (5 - t + 9 * c) * step**4 / 24))
    return float(east), float(north)


@pytest.mark.parametrize("plane", [plane for plane in ANCHORS if plane is not None])
def test_geotiff_lies_where_the_level_frame_says(plane: TangentPlane) -> None:
    made = document(plane=plane)
    _, tags = tiff(written(made, MapFormat.GEOTIFF), "mean_x.tif")
    keys = tags[34735]
    assert isinstance(keys, tuple)
    entries = {keys[i]: keys[i + 1 : i + 4] for i in range(4, len(keys), 4)}
    assert keys[3] == len(entries)
    assert (entries[1024][2], entries[2048][2], entries[3075][2], entries[3076][2]) == (1, 4326, 1, 9001)
    doubles = tags[34736]
    assert isinstance(doubles, tuple)
    lon0, lat0, scale = (doubles[entries[key][2]] for key in (3080, 3081, 3092))
    if 34264 in tags:
        matrix = np.reshape(tags[34264], (4, 4))  # type: ignore[call-overload]
    else:
        (sx, sy, _), tie = tags[33550], tags[33922]  # type: ignore[misc]
        matrix = np.array([[sx, 0, 0, tie[3]], [0, -sy, 0, tie[4]], [0, 0, 0, 0], [0, 0, 0, 1]])  # type: ignore[index]
    rows, _ = made.grid.shape
    for column, row in ((0, 0), (16, 11), (5, 3), (2000, -2000)):
        east, north = (matrix @ [column, row, 0, 1])[:2]
        x = made.grid.x0 + column * made.grid.cell_m
        y = made.grid.y0 + (rows - 1 - row) * made.grid.cell_m
        expected = transverse_mercator(*plane.to_wgs84(x, y), (lon0, lat0), scale)
        # two kilometres out, the plane and the projection differ by a millimetre
        assert (east, north) == pytest.approx(expected, abs=2e-3)


def test_esri_ascii_is_what_the_format_says() -> None:
    made = document(FeatureSet.TOTAL)
    with zipfile.ZipFile(io.BytesIO(written(made, MapFormat.ESRI_ASCII))) as archive:
        lines = archive.read("mean_total.asc").decode().splitlines()
        said = json.loads(archive.read("metadata.json"))
    assert lines[:2] == ["ncols 17", "nrows 12"]
    assert np.array_equal(np.loadtxt(lines[6:]).astype(np.float32)[::-1], made.grid.mean[0])
    assert said["content_hash"] == made.content_hash


def test_xyz_has_degrees_where_there_is_an_anchor() -> None:
    lines = [line for line in written(document(), MapFormat.XYZ).decode().splitlines() if not line.startswith("#")]
    names = lines[0].split()
    assert names[:5] == ["x", "y", "longitude", "latitude", "mean_x"]
    table = np.loadtxt(lines[1:])
    assert len(table) == 12 * 17
    assert table[40, 2:4] == pytest.approx(PLANE.to_wgs84(*table[40, :2]), abs=1e-9)


@pytest.mark.parametrize("kind", [MapFormat.XYZ, MapFormat.ESRI_ASCII])
def test_large_maps_are_not_written_as_text(kind: MapFormat) -> None:
    made = document(FeatureSet.TOTAL, rows=2, columns=MAX_TEXT_NODES // 2 + 1, plan=False)
    with pytest.raises(InputError, match="netcdf"):
        written(made, kind)
