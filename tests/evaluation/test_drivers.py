"""Drivers: the same trip through the engine and through a service."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from app.engine.errors import MapError
from app.engine.types import Prior
from app.evaluation.drivers import EngineDriver, FieldRaster, GridMaps, HttpDriver
from app.evaluation.errors import TransportError
from app.evaluation.protocol import Scenario, make_trip
from tests.evaluation.fakes import DriftingTracker, FailingTracker, FakeService, MapsOf, flat_map, straight_walk

TRIP = make_trip(straight_walk("abc", duration_s=23.0), "lvl", Scenario.TRACKING)


def test_engine_driver_hands_the_state_on() -> None:
    replay = EngineDriver(DriftingTracker(), MapsOf(("lvl",))).replay(TRIP)
    assert len(replay.segment_s) == len(TRIP.segments) == 5
    assert [fix.t for fix in replay.fixes] == sorted(fix.t for fix in replay.fixes)
    assert replay.fixes[-1].x - replay.fixes[0].x == pytest.approx(22 * DriftingTracker().pace, abs=3.0)


def test_replays_repeat() -> None:
    driver = EngineDriver(DriftingTracker(), MapsOf(("lvl",)))
    assert driver.replay(TRIP).fixes == driver.replay(TRIP).fixes


def test_a_refused_segment_is_noted_and_the_trip_goes_on() -> None:
    replay = EngineDriver(FailingTracker(), MapsOf(("lvl",))).replay(TRIP)
    assert len(replay.failures) + len(replay.fixes) == 5
    assert len(replay.segment_s) == len(replay.fixes)
    assert replay.failures
    assert all("not today" in line for line in replay.failures)
    assert replay.failures[0].split(":")[0] in ("segment 0", "segment 1")


def test_a_prior_that_cannot_be_used_gives_no_fix() -> None:
    cold = make_trip(straight_walk("abc"), "lvl", Scenario.COLD)
    replay = EngineDriver(DriftingTracker(), MapsOf(("lvl",))).replay(cold)
    assert replay.fixes == ()
    assert replay.failures == ("start: prior: needs a position",)


def test_grid_maps_names_what_is_missing() -> None:
    maps = GridMaps({"a": flat_map("a")})
    assert maps.level_ids() == ("a",)
    assert maps.grid_map("a").level_id == "a"
    with pytest.raises(MapError, match="'b'"):
        maps.grid_map("b")


def service() -> FakeService:
    return FakeService(built={"lvl"})


def test_http_driver_sends_the_segments_in_order_and_closes() -> None:
    fake = service()
    replay = HttpDriver(fake, "drifting", {"pace": 1.0}).replay(TRIP)
    assert (fake.methods, fake.closed) == (["drifting"], 1)
    assert len(replay.fixes) > 15
    assert replay.failures == ()
    assert replay.fixes[-1].x - replay.fixes[0].x == pytest.approx(22.0, abs=3.0)


def test_a_segment_refused_over_http_keeps_its_number_free() -> None:
    fake = service()
    fake.refuse_seq = 2
    replay = HttpDriver(fake, "drifting", {}).replay(TRIP)
    assert replay.failures == ("segment 2: overloaded",)
    assert len(replay.segment_s) == 4
    assert replay.fixes[-1].t > TRIP.segments[-1].samples.t[0]  # the later ones arrived all the same


def test_a_segment_that_failed_after_it_was_stored_uses_its_number_up() -> None:
    class Fails(FakeService):
        def send_segment(self, session_id, seq, segment):
            fixes = super().send_segment(session_id, seq, segment)
            if seq == 1:
                raise TransportError("the job failed", accepted=True)
            return fixes

    replay = HttpDriver(Fails(built={"lvl"}), "drifting", {}).replay(TRIP)
    assert replay.failures == ("segment 1: the job failed",)


def test_field_raster_shows_the_mapped_magnitude() -> None:
    raster = FieldRaster.of(flat_map("a"))
    assert (raster.x0, raster.y0, raster.cell_m, raster.values.dtype) == (-2.0, -2.0, 1.0, np.float32)
    np.testing.assert_allclose(raster.values[:, :40], np.hypot(20, 40), rtol=1e-6)
    assert np.isnan(raster.values[:, 40:]).all()


def test_a_session_on_a_level_without_a_map_is_the_callers_matter() -> None:
    with pytest.raises(AssertionError):
        service().open_session(Prior("other"), "ven_site", method="", parameters={})


def test_the_evaluation_knows_no_web_library() -> None:
    """Neither HTTP nor the client nor the service: the transport is the caller's. (Matplotlib only for plots.)"""
    script = (
        "import sys, app.evaluation.run; "
        "print([m for m in ('httpx', 'isodyn_client', 'fastapi', 'sqlalchemy', 'pydantic', 'matplotlib')"
        " if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
