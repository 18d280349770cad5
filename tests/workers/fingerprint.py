"""Prints a checksum of a session's states and fixes, for a comparison between processes."""

import sys
import zlib
from dataclasses import replace

from app.engine.mapping import build_map
from app.engine.types import MapBuildSettings
from app.workers.tasks import LocateSegment
from tests.e2e.synthetic import EXTENT, survey_walks
from tests.workers.test_tasks import LEVEL, Shelf, no_progress, ref, specs


def main() -> None:
    walks = [walk.survey(f"wlk_{i}") for i, walk in enumerate(survey_walks())]
    grid_map = build_map(LEVEL, walks, MapBuildSettings(extent=EXTENT)).grid_map
    task = LocateSegment(Shelf({ref(0).path: grid_map}, []).open)
    state, checksum = None, 0
    for spec in specs():
        result = task(replace(spec, state=state), no_progress)
        state = result.state
        checksum = zlib.crc32(state.payload + repr(result.fixes).encode(), checksum)
    sys.stdout.write(f"{zlib.crc32(grid_map.mean.tobytes())} {checksum}\n")


if __name__ == "__main__":
    main()
