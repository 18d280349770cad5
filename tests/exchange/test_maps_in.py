"""Maps from files of others: what is taken, what is assumed, what is refused with a remedy; never a crash."""

from __future__ import annotations

import contextlib
import io
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.io import netcdf_file

from app.engine.errors import InputError
from app.engine.types import FeatureSet
from app.exchange.maps import DEFAULT_SD, MapFormat
from app.exchange.maps.document import Rasters
from app.exchange.maps.esri_ascii import grid_bytes
from app.exchange.maps.geotiff import tiff_bytes
from app.exchange.maps.incoming import ImportChoices, map_of
from tests.exchange.documents import document, esri, read, written

RNG = np.random.default_rng(5)
TOTAL = RNG.normal(48.0, 5.0, (6, 8))


def zipped(**files: bytes) -> bytes:
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "."), content)
    return target.getvalue()


def netcdf(**layers: tuple[np.ndarray, str]) -> bytes:
    target = io.BytesIO()
    file = netcdf_file(target, "w")
    rows, columns = next(iter(layers.values()))[0].shape
    for name, n in (("northing", rows), ("easting", columns)):
        file.createDimension(name, n)
        file.createVariable(name, "f8", (name,))[:] = 10.0 + 0.25 * np.arange(n)
    for name, (values, unit) in layers.items():
        variable = file.createVariable(name, "f4", ("northing", "easting"))
        variable[:] = values
        variable.units = unit.encode()
    file.flush()
    return target.getvalue()


def test_nanotesla_become_microtesla() -> None:
    found = read(netcdf(tmi=(TOTAL * 1000, "nT"), sd=(np.full((6, 8), 250.0), "nT")), MapFormat.NETCDF)
    assert found.grid.features is FeatureSet.TOTAL
    assert found.grid.mean[0] == pytest.approx(TOTAL, rel=1e-6)
    assert found.grid.sd[0] == pytest.approx(np.full((6, 8), 0.25))
    assert (found.grid.x0, found.grid.y0, found.grid.cell_m) == (10.0, 10.0, 0.25)


def test_the_senders_unit_wins() -> None:
    found = read(netcdf(total=(TOTAL * 1000, "furlong")), MapFormat.NETCDF, unit="nT")
    assert found.grid.mean[0] == pytest.approx(TOTAL, rel=1e-6)


def test_what_is_assumed_is_said() -> None:
    found = read(esri(TOTAL), MapFormat.ESRI_ASCII, channel="total")
    assert found.grid.mean[0] == pytest.approx(TOTAL[::-1], abs=1e-3)
    assert (found.grid.sd == DEFAULT_SD).all()
    assert found.grid.noise_sd == (DEFAULT_SD,)
    words = " ".join(found.assumed)
    assert all(part in words for part in ("unit", "standard deviation", "support", "noise_sd"))
    assert read(esri(TOTAL), MapFormat.ESRI_ASCII, channel="total", sd=1.5).grid.sd.max() == 1.5


def test_corners_and_centres_are_told_apart() -> None:
    centre, corner = (read(esri(TOTAL, corner=c), MapFormat.ESRI_ASCII, channel="total").grid for c in (False, True))
    assert (corner.x0 - centre.x0, corner.y0 - centre.y0) == (0.25, 0.25)


def test_nodes_without_a_value_are_unmapped_and_uninformative() -> None:
    values = TOTAL.copy()
    values[0, :3] = -9999
    found = read(esri(values), MapFormat.ESRI_ASCII, channel="total")
    gone = np.zeros((6, 8), bool)
    gone[-1, :3] = True
    assert np.array_equal(found.grid.mapped, ~gone)
    known = found.grid.mean[0][~gone]
    assert found.grid.mean[0][gone] == pytest.approx(np.full(3, known.mean()), rel=1e-5)
    assert (found.grid.sd[0][gone] >= known.std() * 0.999).all()


def test_a_vector_map_of_single_grids() -> None:
    content = zipped(
        bx__asc=esri(TOTAL), by__asc=esri(TOTAL + 1), bz__asc=esri(TOTAL + 2), std_x__asc=esri(TOTAL * 0 + 1)
    )
    found = read(content, MapFormat.ESRI_ASCII)
    assert found.grid.features is FeatureSet.VECTOR
    assert found.grid.mean[2] == pytest.approx(TOTAL[::-1] + 2, abs=1e-3)
    # one of three is not enough to go by
    assert (found.grid.sd == DEFAULT_SD).all()


@pytest.mark.parametrize("turned", [False, True])
def test_netcdf_in_any_order_of_dimensions(turned: bool) -> None:
    target = io.BytesIO()
    file = netcdf_file(target, "w")
    for name, n in (("x", 8), ("y", 6)):
        file.createDimension(name, n)
        axis = file.createVariable(name, "f8", (name,))
        axis[:] = np.arange(n)[:: -1 if name == "y" and turned else 1]
    file.createVariable("total", "f8", ("x", "y"))[:] = TOTAL.T
    file.flush()
    found = read(target.getvalue(), MapFormat.NETCDF)
    assert found.grid.mean[0] == pytest.approx(TOTAL[::-1] if turned else TOTAL, rel=1e-6)


def test_packed_and_missing_netcdf_values() -> None:
    target = io.BytesIO()
    file = netcdf_file(target, "w", version=2)
    for name, n in (("y", 6), ("x", 8)):
        file.createDimension(name, n)
        file.createVariable(name, "f8", (name,))[:] = np.arange(n)
    packed = file.createVariable("total", "i2", ("y", "x"))
    packed[:] = np.round((TOTAL - 40) * 100)
    packed[2, 3] = -32768
    packed._FillValue = np.array(-32768, ">i2")
    packed.scale_factor = np.array(0.01)
    packed.add_offset = np.array(40.0)
    file.flush()
    found = read(target.getvalue(), MapFormat.NETCDF)
    mapped = found.grid.mapped
    assert not mapped[2, 3]
    assert mapped.sum() == 47
    assert found.grid.mean[0][mapped] == pytest.approx(TOTAL[mapped], abs=0.006)


def test_a_geotiff_of_another_program() -> None:
    target = io.BytesIO()
    image = Image.fromarray(TOTAL.astype(np.float32))
    tags = {33550: (0.5, 0.5, 0.0), 33922: (0.0, 0.0, 0.0, 3.0, 9.0, 0.0)}
    image.save(target, "TIFF", tiffinfo=tags)
    found = read(target.getvalue(), MapFormat.GEOTIFF, channel="total")
    # pixels are areas unless it says otherwise: the tie point is the outer corner
    assert (found.grid.x0, found.grid.y0) == (3.25, 9.0 - 0.25 - 5 * 0.5)
    assert found.grid.mean[0] == pytest.approx(TOTAL[::-1], rel=1e-6)


def test_xyz_in_any_order_and_with_gaps() -> None:
    nodes = [(x, y, TOTAL[y, x]) for y in range(6) for x in range(8) if (x, y) != (2, 2)]
    RNG.shuffle(nodes)
    text = "\n".join(f"{100 + 0.1 * x:.1f},{50 + 0.1 * y:.1f},{value:.4f}" for x, y, value in nodes)
    found = read(text.encode(), MapFormat.XYZ, channel="total")
    assert found.grid.shape == (6, 8)
    assert found.grid.cell_m == pytest.approx(0.1)
    assert not found.grid.mapped[2, 2]
    assert found.grid.mean[0][found.grid.mapped] == pytest.approx(TOTAL[found.grid.mapped], abs=1e-4)


def test_the_length_scale_is_that_of_the_field() -> None:
    x, y = np.meshgrid(np.arange(200) * 0.5, np.arange(160) * 0.5)
    waves = sum(
        np.cos(k * (np.cos(a) * x + np.sin(a) * y) + p)
        for k, a, p in zip(RNG.rayleigh(1 / 4.0, 200), RNG.uniform(0, 7, 200), RNG.uniform(0, 7, 200), strict=True)
    )
    rasters = Rasters(x[0], y[:, 0], {"total": 48 + waves}, {"total": "uT"}, {})
    # Gaussian spectrum of width 1/4 per metre: slopes of s/4, as those of Matern 3/2 of length 4 sqrt(3)
    assert map_of(rasters, "lvl", ImportChoices()).length_scale_m == pytest.approx(4 * np.sqrt(3), rel=0.15)


def rasters(**changes: object) -> Rasters:
    values = {"x": np.arange(8.0), "y": np.arange(6.0), "layers": {"total": TOTAL}, "units": {}, "attributes": {}}
    return Rasters(**{**values, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "field", "remedy"),
    [
        ({"x": np.array([0, 1, 2, 3, 4, 5, 6, 7.2])}, "x", "even lattice"),
        ({"x": np.arange(8.0) * 2}, "file", "square cells"),
        ({"y": np.array([0, 1, 2, np.nan, 4, 5])}, "y", "metres"),
        ({"x": np.arange(8.0) * 1e-5, "y": np.arange(6.0) * 1e-5}, "file", "metres of the level"),
        ({"layers": {"depth": TOTAL}}, "file", "channel="),
        ({"layers": {"x": TOTAL, "y": TOTAL}}, "file", "one feature set"),
        ({"layers": {"total": TOTAL, "tmi": TOTAL}}, "file", "send one of them"),
        ({"layers": {"total": TOTAL * 1000}}, "file", "unit=nT"),
        ({"layers": {"total": TOTAL * np.nan}}, "file", "grid with values"),
        ({"layers": {"total": np.where(TOTAL > 48, np.inf, TOTAL)}}, "file", "NaN"),
        ({"layers": {"total": np.where(TOTAL.max() == TOTAL, 1e5, TOTAL)}}, "file", "take out"),
        ({"units": {"total": "tesla"}}, "total", "unit="),
        ({"layers": {"total": TOTAL, "sd": TOTAL * -1}}, "sd", "send it for all"),
        ({"layers": {"total": TOTAL, "support": TOTAL * np.nan}}, "support", "send metres"),
    ],
)
def test_refusals_name_field_and_remedy(changes: dict[str, object], field: str, remedy: str) -> None:
    with pytest.raises(InputError) as caught:
        map_of(rasters(**changes), "lvl", ImportChoices())
    assert caught.value.field == field
    assert remedy in caught.value.message


@pytest.mark.parametrize(
    ("content", "kind", "words"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(100), MapFormat.NETCDF, "nccopy"),
        (b"hello", MapFormat.NETCDF, "does not begin"),
        (b"CDF\x01", MapFormat.NETCDF, "ends inside"),
        (b"ncols 3\nnrows 3\n1 2 3\n", MapFormat.ESRI_ASCII, "cellsize"),
        (
            b"ncols 3000\nnrows 3000\ncellsize 1\nxllcorner 0\nyllcorner 0\n1 2 3\n",
            MapFormat.ESRI_ASCII,
            "than the file",
        ),
        (esri(TOTAL)[:-30], MapFormat.ESRI_ASCII, "whole grid"),
        (esri(TOTAL).replace(b"48", b"4e", 1), MapFormat.ESRI_ASCII, "line "),
        (zipped(note__txt=b"x"), MapFormat.ESRI_ASCII, "no grid"),
        (zipped(total__asc=esri(TOTAL), sd__asc=esri(TOTAL, x=9.0)), MapFormat.ESRI_ASCII, "another lattice"),
        (zipped(total__asc=esri(TOTAL), metadata__json=b"[" * 9000), MapFormat.ESRI_ASCII, "JSON"),
        (b"PK\x03\x04" + bytes(40), MapFormat.GEOTIFF, "damaged archive"),
        (b"II*\0", MapFormat.GEOTIFF, "TIFF"),
        (b"x y total\n0 0 1\n1 0\n", MapFormat.XYZ, "line 3"),
        (b"0 0 48\n1 0 49\n0 1 50\n0 1 51\n", MapFormat.XYZ, "twice"),
        (b"0 0 48\n1 0 49\n3.3 1 50\n", MapFormat.XYZ, "off the lattice"),
        (b"lon lat v\n1 2 3\n", MapFormat.XYZ, "level metres"),
        (b"", MapFormat.XYZ, "no nodes"),
    ],
)
def test_damaged_files_are_refused_in_words(content: bytes, kind: MapFormat, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(content, kind, channel="total")


def test_a_raster_that_claims_to_be_large_is_not_unpacked() -> None:
    for side in (5_000, 60_000):  # beyond what is taken, and beyond what Pillow would open
        content = tiff_bytes(document(rows=4, columns=5), next(document(rows=4, columns=5).layers()))
        at = content.index(struct.pack("<HHII", 256, 4, 1, 5))
        claimed = content[:at] + struct.pack("<HHII", 256, 4, 1, side) + struct.pack("<HHII", 257, 4, 1, side)
        with pytest.raises(InputError, match="pixels"):
            read(claimed + content[at + 24 :], MapFormat.GEOTIFF)


def test_an_archive_that_inflates_without_end_is_not_inflated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.exchange.maps.archive.MAX_INFLATED", 10**7)
    content = _bomb()
    assert len(content) < 10**5
    with pytest.raises(InputError, match="bytes"):
        read(content, MapFormat.ESRI_ASCII, channel="total")


def _bomb() -> bytes:
    """An archive of 16 MB of zeros, in 16 kB."""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("total.asc", "w") as file:
        for _ in range(16):
            file.write(bytes(10**6))
    return target.getvalue()


SMALL = document(FeatureSet.TOTAL, rows=4, columns=5)
VALID = {
    "netcdf": written(SMALL, MapFormat.NETCDF),
    "xyz": written(SMALL, MapFormat.XYZ),
    "esri-ascii": grid_bytes(SMALL, next(SMALL.layers())),
    "geotiff": tiff_bytes(SMALL, next(SMALL.layers())),
    "zip of esri-ascii": written(SMALL, MapFormat.ESRI_ASCII),
}
"""Bare grids too: a zip file's checksums hide its members from changes."""


@pytest.mark.parametrize("name", VALID)
@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_nothing_crashes_a_reader(name: str, data: st.DataObject) -> None:
    """Cut short, overwritten and pure garbage: a map or an InputError."""
    content = bytearray(VALID[name])
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        patch = data.draw(st.binary(min_size=1, max_size=8) | st.just(struct.pack(">i", 2**31 - 1)))
        content[at : at + len(patch)] = patch
    cut = data.draw(st.none() | st.integers(0, len(content)))
    garbage = data.draw(st.none() | st.binary(max_size=60))
    tried = bytes(content[:cut]) if garbage is None else VALID[name][:4] + garbage
    with contextlib.suppress(InputError):
        found = read(tried, MapFormat(name.rpartition(" ")[2]))
        assert np.isfinite(found.grid.mean).all()
        assert (found.grid.sd >= 0).all()
