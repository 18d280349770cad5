"""Recorded walks as Sensor Logger pushes them: the fixes of a native upload, with the same random numbers.

``python -m pytest tests/evaluation/test_pushed_walks.py -rP`` prints how far the two are apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from app.engine.localization import create_tracker
from app.engine.types import ImuSamples, Segment
from app.evaluation.datasets.ilc20 import open_ilc20
from app.evaluation.drivers import EngineDriver, GridMaps
from app.evaluation.levels import prepare_task
from app.evaluation.prepare import prepare_level
from app.evaluation.protocol import EvaluationOptions, Scenario, Trip, make_trip
from app.exchange.phones.assembly import PhoneFrame, assemble
from app.exchange.phones.readings import Readings
from app.exchange.phones.sensor_logger import read_message
from app.services.ingest.order import in_turn
from app.services.ingest.receiving import pieces
from app.services.ingest.records import Stored
from tests.support.phones import Phone, sensor_logger_messages

pytestmark = [pytest.mark.slow]

SAMPLES = Path(__file__).parents[2] / "maps" / "samples"
SECONDS = 60.0
NEAR_M = 0.1
"""What the fixes of a stream may differ from those of an upload."""


@pytest.fixture(scope="module")
def floor() -> tuple[EngineDriver, list[Trip]]:
    options = EvaluationOptions(SAMPLES)
    data = open_ilc20(SAMPLES)
    level = data.level(data.levels()[0])
    prepared = prepare_level(prepare_task(level, options, with_map=True))
    assert prepared.grid_map is not None
    driver = EngineDriver(create_tracker("particle", {}), GridMaps({level.name: prepared.grid_map}))
    trips = [make_trip(walk, level.name, Scenario.TRACKING) for walk in level.walks("test")]
    trips = [replace(trip, segments=tuple(cut(first_minute(trip), 1.0))) for trip in trips]
    return driver, [trip for trip in trips if len(trip.segments) > 20]


def first_minute(trip: Trip) -> ImuSamples:
    parts = [segment.samples for segment in trip.segments]
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "mag", "acc", "gyro")]
    rows = columns[0] < columns[0][0] + SECONDS
    return ImuSamples(*(column[rows] for column in columns))


def chosen(samples: ImuSamples, rows: slice | np.ndarray) -> ImuSamples:
    return ImuSamples(samples.t[rows], samples.mag[rows], samples.acc[rows], samples.gyro[rows])


def cut(samples: ImuSamples, seconds: float) -> Iterator[Segment]:
    number = ((samples.t - samples.t[0] + 1e-6) // seconds).astype(int)
    for one in np.unique(number):
        rows = number == one
        if rows.sum() > 1:
            yield Segment(chosen(samples, rows))


def pushed(samples: ImuSamples, phone: Phone) -> tuple[Segment, ...]:
    """Segments that the service cuts of the messages of a walk; some come late, some twice."""
    bodies = sensor_logger_messages(samples, phone=phone, swapped=[3, 15], repeated=[7])
    now, expected, rest, until = datetime(2026, 1, 1, tzinfo=UTC), 0, Readings(), None
    waiting: dict[int, Stored] = {}
    segments: list[Segment] = []
    for place, body in enumerate(bodies):
        message = read_message(body)
        number = message.message_id or 0
        if number >= expected:
            waiting.setdefault(number, Stored(number, message.readings.pack(), now))
        turn, expected = in_turn([waiting[one] for one in sorted(waiting)], expected, now)
        rest = Readings.merged([rest, *(Readings.unpack(waiting.pop(one.number).readings) for one in turn)])
        frame = PhoneFrame.IOS if phone.ios else PhoneFrame.ANDROID
        done = assemble(rest, frame, after_ns=until, final=place == len(bodies) - 1)
        rest, until = done.rest, done.until_ns
        if done.samples is not None:
            segments += [Segment(chosen(done.samples, rows)) for rows in pieces(done.samples)]
    return tuple(segments)


def test_a_stream_gives_the_fixes_of_an_upload(floor: tuple[EngineDriver, list[Trip]]) -> None:
    driver, trips = floor
    assert len(trips) >= 8
    for trip in trips:
        native = {round(fix.t, 4): (fix.x, fix.y) for fix in driver.replay(trip).fixes}
        for phone in (Phone(), Phone(ios=True)):
            segments = pushed(first_minute(trip), phone)
            streamed = {
                round(fix.t, 4): (fix.x, fix.y) for fix in driver.replay(replace(trip, segments=segments)).fixes
            }
            common = sorted(native.keys() & streamed.keys())
            # a segment tells one fix more at its end, and messages that were interchanged are one segment
            assert len(common) >= len(native) - 2
            gap = np.hypot(*(np.array([native[t] for t in common]) - np.array([streamed[t] for t in common])).T)
            print(f"{trip.walk_id} {phone.ios=}: {len(common)} fixes, at most {gap.max():.4f} m apart")  # noqa: T201
            assert gap.max() < NEAR_M


def test_clocks_of_their_own_cost_little(floor: tuple[EngineDriver, list[Trip]]) -> None:
    """Sensors read at other moments, up to half a sample apart: the answers are alike, not equal."""
    driver, trips = floor
    medians = []
    for trip in trips:
        native = driver.replay(trip).fixes
        segments = pushed(first_minute(trip), Phone(asynchronous=True))
        streamed = driver.replay(replace(trip, segments=segments)).fixes
        t, at = (np.array([fix.t for fix in fixes]) for fixes in (native, streamed))
        x, y = (np.interp(t, at, [getattr(fix, name) for fix in streamed]) for name in "xy")
        gap = np.hypot(x - [fix.x for fix in native], y - [fix.y for fix in native])
        medians.append(float(np.median(gap)))
        print(f"{trip.walk_id}: median {medians[-1]:.3f} m, 95 % {np.percentile(gap, 95):.3f} m")  # noqa: T201
    assert np.median(medians) < 0.6
