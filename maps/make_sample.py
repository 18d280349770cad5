"""Make the committed sample: one real floor, reduced to what the demo and the tests need.

    python maps/make_sample.py --data DIR            # DIR holds ilc20/<level>/, as the full data set does

Everything kept is kept without loss; what is left out is listed in PROVENANCE.md beside the sample. The output has
the format of the input, so every reader of the full set reads the sample.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

LEVEL = "site1-F2"
WIFI_MAX_AGE_MS = 3000
SENSOR_COLUMNS = ["mx", "my", "mz", "ax", "ay", "az", "gx", "gy", "gz"]
# the magnetometer takes few distinct values (a dictionary wins); the others fill the mantissa (split bytes win)
DICTIONARY_COLUMNS = ["trace_id", "mx", "my", "mz"]
COPIED = ("floor.json", "floor_image.png", "geojson_map.json", "traces.parquet", "waypoints.parquet")
LIMIT_BYTES = 8_000_000
DOCUMENTS = ("LICENSE", "PROVENANCE.md")


def main(arguments: list[str] | None = None) -> int:
    """Write the sample and print its size and hash."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, prog="make_sample.py"
    )
    parser.add_argument("--data", type=Path, required=True, help="folder that holds ilc20/<level>/")
    parser.add_argument("--level", default=LEVEL, help="level to take (default: %(default)s)")
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parent / "samples", help="folder to write ilc20/<level>/ into"
    )
    options = parser.parse_args(arguments)
    source = options.data / "ilc20" / options.level
    if not (source / "traces.parquet").is_file():
        parser.error(f"{source} holds no traces.parquet")
    target = options.out / "ilc20" / options.level
    target.mkdir(parents=True, exist_ok=True)
    make(source, target)
    size = sum(path.stat().st_size for path in target.iterdir())
    print(f"{target}: {size / 1e6:.2f} MB")
    print(f'sha256 = "{folder_hash(target)}"')
    if size > LIMIT_BYTES:
        print(f"more than {LIMIT_BYTES / 1e6:.0f} MB", file=sys.stderr)
        return 1
    return 0


def make(source: Path, target: Path) -> None:
    """Reduce one level folder to another."""
    for name in COPIED:
        shutil.copyfile(source / name, target / name)
    imu = pq.read_table(source / "imu.parquet", columns=["trace_id", "t", *SENSOR_COLUMNS])
    split = [name for name in SENSOR_COLUMNS if name not in DICTIONARY_COLUMNS]
    encoding = {"t": "DELTA_BINARY_PACKED"} | dict.fromkeys(split, "BYTE_STREAM_SPLIT")
    _write(imu, target / "imu.parquet", encoding)
    wifi = pq.read_table(source / "wifi.parquet", columns=["trace_id", "t", "bssid", "rssi", "freq_mhz", "age_ms"])
    fresh = pc.and_(pc.greater_equal(wifi["age_ms"], 0), pc.less_equal(wifi["age_ms"], WIFI_MAX_AGE_MS))
    _write(wifi.filter(fresh), target / "wifi.parquet", {"age_ms": "DELTA_BINARY_PACKED"})


def folder_hash(folder: Path) -> str:
    """SHA-256 over the lines ``<sha256 of file>  <name>`` of the data files, sorted by name."""
    names = sorted(path.name for path in folder.iterdir() if path.name not in DOCUMENTS)
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _write(table: pa.Table, path: Path, encoding: dict[str, str]) -> None:
    """Write one row group at the highest compression; no pandas meta data."""
    pq.write_table(
        table.replace_schema_metadata(None),
        path,
        compression="zstd",
        compression_level=22,
        use_dictionary=[name for name in table.column_names if name not in encoding],
        column_encoding=encoding,
        row_group_size=max(table.num_rows, 1),
        data_page_size=8 << 20,
    )


if __name__ == "__main__":
    sys.exit(main())
