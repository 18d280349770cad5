"""The Python client against the real service: every call, every answer read."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path

import httpx
import isodyn_client as isodyn
import numpy as np
import pytest
from isodyn_client import endpoints
from isodyn_client.errors import problem_from

from app.api.errors import PROBLEM_TYPES, Problem, ProblemType
from app.api.validation import FieldError
from app.cli.convert import samples_of, waypoints_of, wifi_of
from app.evaluation.datasets.ilc20 import Ilc20Level, RecordedWalk
from app.main import create_app
from app.services.accounts import AccountService
from app.services.clock import utc_now
from app.services.records import Scope
from app.settings import Settings
from app.storage.database import Database
from tests.cli.conftest import SAMPLE, Service, Surveyed


@pytest.fixture(scope="module")
def walk() -> RecordedWalk:
    return next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))


def start_of(walk: RecordedWalk) -> isodyn.Prior:
    return isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]), heading_deg=10.0)


def test_venues_and_levels(service: Service) -> None:
    with service.client() as client:
        anchor = isodyn.Anchor(latitude_deg=48.15, longitude_deg=11.57, bearing_deg=12.5)
        venue = client.create_venue("Mall", kind="area", anchor=anchor)
        assert client.venue(venue.id) == venue
        assert (venue.kind, venue.anchor) == (isodyn.VenueKind.AREA, anchor)
        assert client.update_venue(venue.id, name="Other").name == "Other"
        assert venue.id in {one.id for one in client.venues()}
        level = client.create_level(venue.id, "F1", extent=isodyn.Extent(x_min=0, y_min=0, x_max=9, y_max=9))
        assert client.level(level.id) == level
        assert [one.id for one in client.levels(venue_id=venue.id)] == [level.id]
        assert client.update_level(level.id, ordinal=3).ordinal == 3
        assert client.update_level(level.id, ordinal=0, extent=(0, 0, 12, 9)).extent.x_max == 12.0
        near = {"near": (48.15, 11.57), "radius_m": 50.0}
        assert [(one.id, one.distance_m) for one in client.levels(**near, q="f1", ordinal=0)] == [(level.id, 0.0)]
        assert [one.id for one in client.venues(**near)] == [venue.id]
        assert [one.id for one in client.levels(bbox=(11.5, 48.1, 11.6, 48.2), q="oth")] == [level.id]
        with pytest.raises(isodyn.NotFoundError):
            client.plan_image(level.id)
        with pytest.raises(isodyn.InvalidRequestError):
            client.set_plan_image(level.id, b"not a PNG")
        with pytest.raises(isodyn.ConflictError):
            client.delete_venue(venue.id)
        empty = client.create_venue("Empty")
        client.delete_venue(empty.id)
        with pytest.raises(isodyn.NotFoundError):
            client.venue(empty.id)


def test_an_idempotent_creation_gives_the_first_thing_again(service: Service) -> None:
    call = endpoints.create_venue("Twice")
    with service.client() as client:
        assert client.call(call).id == client.call(call).id


def test_devices(service: Service) -> None:
    with service.client() as client:
        device = client.create_device("phone", model="PBCM10")
        assert client.device(device.id).model_copy(update={"next_session": None}) == device
        assert device.id in {one.id for one in client.devices()}
        assert client.device(device.id).next_session == isodyn.SessionStart(epoch="", source="none")
        assert {one.name: one.n_devices for one in client.device_models()}["PBCM10"] == 1
        assert client.device_model("PBCM10").estimate is None
        with pytest.raises(isodyn.NotFoundError):
            client.device_model("no such/model")


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
@pytest.mark.parametrize("gzip", [False, True])
def test_the_same_walk_is_the_same_walk_however_it_is_sent(
    service: Service, surveyed: Surveyed, walk: RecordedWalk, encoding: str, gzip: bool
) -> None:
    with service.client() as client:
        survey = client.create_survey(surveyed.level_id, f"{encoding} {gzip}")
        first = client.add_walk(survey.id, "a", samples_of(walk.samples), waypoints_of(walk.waypoints))
        again = client.add_walk(
            survey.id, "b", samples_of(walk.samples), waypoints_of(walk.waypoints), encoding=encoding, gzip=gzip
        )
        assert again.id == first.id
        assert (first.n_samples, first.n_waypoints) == (len(walk.samples), len(walk.waypoints))
        assert first.length_m == pytest.approx(walk.path_length_m, rel=1e-3)
        assert client.walk(survey.id, first.id) == first
        assert client.survey(survey.id).n_walks == 1
        track = next(one for one in client.waypoints(survey.level_id) if one.walk_id == first.id)
        assert track.x == pytest.approx(walk.waypoints.x, abs=1e-3)
        assert track.t_ms == pytest.approx(1e3 * walk.waypoints.t, abs=1.0)
        client.delete_walk(survey.id, first.id)
        assert list(client.walks(survey.id)) == []


def test_maps(service: Service, surveyed: Surveyed) -> None:
    with service.client() as client:
        info = client.map_info(surveyed.map_id)
        assert info.id in {one.id for one in client.maps(level_id=surveyed.level_id)}
        raster = client.map_field(info.id, "z")
        coverage = client.map_coverage(info.id)
        assert raster.values.shape == coverage.mapped.shape == (info.rows, info.columns)
        np.testing.assert_array_equal(np.isfinite(raster.values), coverage.mapped)
        assert (raster.x0, raster.y0, raster.cell_m) == pytest.approx((info.x0, info.y0, info.cell_m))
        spread = client.map_field(info.id, "z", statistic="sd").values[coverage.mapped]
        assert (spread > 0).all()
        with pytest.raises(isodyn.InvalidRequestError):
            client.map_field(info.id, "w")


def test_planning(service: Service, surveyed: Surveyed) -> None:
    with service.client() as client:
        found = client.map_quality(surveyed.map_id)
        assert found.coverage.by_plan
        raster = client.quality_raster(surveyed.map_id)
        assert np.nanmedian(raster.values) == pytest.approx(found.mean_error.p50_m, rel=1e-3)
        assert client.quality_image(surveyed.map_id, "along", heading_deg=90).startswith(b"\x89PNG")
        plan = client.survey_suggestions(surveyed.map_id, count=2)
        first = plan.suggestions[0]
        assert len(plan.suggestions) == 2
        forecast = client.forecast_route(surveyed.map_id, [first.start, first.end], known_m=2.0)
        assert forecast.length_m == pytest.approx(first.length_m, abs=0.02)
        with pytest.raises(isodyn.NoAnchorError):
            client.suggestions_geojson(surveyed.map_id)
        with pytest.raises(isodyn.InvalidRequestError):
            client.quality_raster(surveyed.map_id, "error", heading_deg=10)


def test_a_session_from_first_to_last(service: Service, surveyed: Surveyed, walk: RecordedWalk) -> None:
    samples = samples_of(walk.samples)
    with service.client() as client:
        with client.open_session(surveyed.level_id, prior=start_of(walk), parameters={"particles": 500}) as session:
            results = list(session.send_all(samples, aids=isodyn.Aids(wifi=wifi_of(walk.wifi)), wait=20))
            first = isodyn.Aids(wifi=first_wifi(walk, samples))
            repeated = client.send_segment(session.id, 0, next(samples.split()), aids=first, wait=1)
        assert [result.seq for result in results] == list(range(len(results)))
        assert all(result.fixes is not None and result.position is not None for result in results)
        assert repeated.fixes is not None
        np.testing.assert_array_equal(repeated.fixes.xy, results[0].fixes.xy)  # type: ignore[union-attr]
        assert session.info.status is isodyn.SessionStatus.CLOSED
        fixes = session.positions()
        assert len(fixes) == sum(len(result.fixes) for result in results if result.fixes)
        last = results[-1].position
        assert last is not None
        assert (last.x, last.y) == (fixes.x[-1], fixes.y[-1])
        assert fixes.ellipse95(-1).semi_major_m == pytest.approx(last.ellipse95.semi_major_m, abs=2e-3)
        assert len(session.positions(seq=1)) == len(results[1].fixes or ())
        later = session.positions(kind="fixed_lag")
        assert later.kind == (isodyn.FixKind.FIXED_LAG,) * len(later)
        told = [result.fixed_lag for result in results if result.fixed_lag is not None]
        np.testing.assert_array_equal(later.t_ms, np.concatenate([part.t_ms for part in told]))
        assert len(set(later.t_ms)) == len(later) > 10
        assert set(later.t_ms) <= set(fixes.t_ms)
        assert [info.seq for info in client.segments(session.id)] == list(range(len(results)))
        smoothed = session.trajectory()
        assert set(smoothed.kind) == {isodyn.FixKind.SMOOTHED}
        assert len(smoothed) > 10
        assert set(smoothed.t_ms) <= set(fixes.t_ms)
        with pytest.raises(isodyn.SessionClosedError):
            session.send(samples)
        other = client.create_session(surveyed.level_id, method="dead_reckoning")
        with pytest.raises(isodyn.ConflictError) as caught:
            client.trajectory(other.id)
        assert caught.value.field == "method"


def test_a_session_in_a_venue_names_the_level_of_every_fix(
    service: Service, surveyed: Surveyed, walk: RecordedWalk
) -> None:
    samples = samples_of(walk.samples)
    with service.client() as client:
        venue_id = client.level(surveyed.level_id).venue_id
        with client.open_session(venue_id=venue_id, parameters={"particles": 500, "cold_particles": 500}) as session:
            results = list(session.send_all(samples, wait=20))
        assert (session.info.venue_id, session.info.level_id, session.info.map_id) == (venue_id, None, None)
        assert session.info.maps == (isodyn.LevelMap(level_id=surveyed.level_id, map_id=surveyed.map_id),)
        assert session.id in {one.id for one in client.sessions(venue_id=venue_id)}
        assert all(result.state is isodyn.JobState.DONE for result in results)
        fixes = session.positions()
        assert set(fixes.level_id) == set(session.trajectory().level_id) == {surveyed.level_id}
        assert {place.level_id for places in fixes.hypotheses for place in places} <= {surveyed.level_id}
        once = client.locate(None, samples[:500], venue_id=venue_id)
        assert (once.map_id, once.maps) == (None, session.info.maps)
        with pytest.raises(isodyn.InvalidRequestError) as caught:
            client.create_session(venue_id=venue_id, prior=start_of(walk))
        assert (caught.value.field, caught.value.remedy) == ("prior.x", "send level_id, or leave x and y out")
        with pytest.raises(isodyn.NoMapError):
            client.create_session(venue_id=client.create_venue("Empty").id)


def test_a_session_teaches_the_next_one_of_its_device(service: Service, surveyed: Surveyed, walk: RecordedWalk) -> None:
    with service.client() as client:
        device = client.create_device("phone that learns")

        def open_session(epoch: str) -> isodyn.Session:
            return client.open_session(
                surveyed.level_id, prior=start_of(walk), device_id=device.id, calibration_epoch=epoch
            )

        with open_session("bias-1") as first:
            assert first.info.calibration is None
            list(first.send_all(samples_of(walk.samples), wait=20))
            first.wait_for(first.next_seq - 1, timeout=120.0)  # a busy machine may take longer
        (known,) = client.device(device.id).calibrations
        assert (known.epoch, known.n_sessions) == ("bias-1", 1)
        assert all(2.0 <= sd <= 5.5 for sd in known.offset_sd)
        assert 0.04 <= known.stride_scale_sd <= 0.13
        with open_session("bias-1") as second:
            assert second.info.calibration is not None
            assert second.info.calibration.offset == known.offset
            assert second.info.calibration.offset_sd > known.offset_sd
            results = list(second.send_all(samples_of(walk.samples), wait=20))
        assert all(result.fixes for result in results)
        assert client.device(device.id).calibrations[0].n_sessions == 2
        other = open_session("bias-2").info.calibration
        assert other is not None
        assert other.offset == (0.0, 0.0, 0.0)
        client.forget_calibrations(device.id)
        assert client.device(device.id).calibrations == ()
        assert open_session("bias-1").info.calibration is None


def first_wifi(walk: RecordedWalk, samples: isodyn.Samples) -> isodyn.WifiScans | None:
    wifi = wifi_of(walk.wifi)
    first = next(samples.split())
    return wifi.between(-np.inf, first.t_ms[-1] + 1.0) if wifi else None


def test_wrong_segments_have_their_errors(service: Service, surveyed: Surveyed, walk: RecordedWalk) -> None:
    pieces = list(samples_of(walk.samples).split(2.0))
    with service.client() as client:
        session = client.open_session(surveyed.level_id, prior=start_of(walk))
        session.send(pieces[0])
        with pytest.raises(isodyn.SequenceGapError):
            client.send_segment(session.id, 5, pieces[1])
        with pytest.raises(isodyn.SequenceConflictError):
            client.send_segment(session.id, 0, pieces[1])
        tesla = isodyn.Samples(pieces[1].t_ms, pieces[1].mag * 1000, pieces[1].acc, pieces[1].gyro)
        with pytest.raises(isodyn.InvalidRequestError, match="nT") as caught:
            session.send(tesla)
        assert (caught.value.field or "").startswith("samples.mag")
        assert caught.value.remedy
        assert session.next_seq == 1
        assert session.wait_for(0).state is isodyn.JobState.DONE


def test_waiting_later_gives_the_same(service: Service, surveyed: Surveyed, walk: RecordedWalk) -> None:
    with service.client() as client:
        session = client.open_session(surveyed.level_id, prior=start_of(walk))
        for piece in list(samples_of(walk.samples).split())[:2]:
            session.send(piece)
        later = client.resume_session(session.id)
        assert later.next_seq == 2
        assert later.wait_for(1).fixes is not None


def test_one_shot(service: Service, surveyed: Surveyed, walk: RecordedWalk) -> None:
    samples = samples_of(walk.samples)[:500]
    with service.client() as client:
        result = client.locate(surveyed.level_id, samples, prior=start_of(walk), method="dead_reckoning")
        assert (result.method, result.map_id) == ("dead_reckoning", surveyed.map_id)
        assert len(result.fixes) > 5
        with pytest.raises(isodyn.InvalidRequestError):
            client.locate(surveyed.level_id, samples, method="crystal_ball")


def test_geojson_needs_an_anchor(service: Service, surveyed: Surveyed, walk: RecordedWalk) -> None:
    with service.client() as client:
        session = client.open_session(surveyed.level_id, prior=start_of(walk))
        session.send(next(samples_of(walk.samples).split()), wait=20)
        with pytest.raises(isodyn.NoAnchorError):
            client.positions_geojson(session.id)
        venue_id = client.level(surveyed.level_id).venue_id
        client.update_venue(venue_id, anchor=isodyn.Anchor(latitude_deg=30.3, longitude_deg=120.1))
        collection = json.loads(client.positions_geojson(session.id))
    longitude, latitude = collection["features"][0]["geometry"]["coordinates"]
    assert (longitude, latitude) == (pytest.approx(120.1, abs=0.01), pytest.approx(30.3, abs=0.01))


def every_aid(samples: isodyn.Samples) -> isodyn.Aids:
    """Made-up readings over the whole recording."""
    t_ms = samples.t_ms[::100]
    n = len(t_ms)
    return isodyn.Aids(
        wifi=isodyn.WifiScans(t_ms, ["02:00:00:00:00:01"] * n, np.full(n, -60.5)),
        ble=isodyn.BleScans(t_ms, ["c0:ff:ee:00:00:01"] * n, np.full(n, -71.0)),
        gnss=isodyn.GnssFixes(t_ms, np.full(n, 30.3), np.full(n, 120.1), np.full(n, 25.0)),
        pressure=isodyn.PressureReadings(t_ms, np.linspace(1003.0, 1003.4, n)),
        speed=isodyn.SpeedReadings(t_ms, np.full(n, 1.3)),
        steps=isodyn.StepCounts(t_ms, np.arange(n)),
    )


def test_every_aid_may_come_with_segments_and_one_shot_requests(
    service: Service, surveyed: Surveyed, walk: RecordedWalk
) -> None:
    samples = samples_of(walk.samples)[:800]
    aids = every_aid(samples)
    with service.client() as client:
        venue = client.venue(client.level(surveyed.level_id).venue_id)
        if venue.anchor is None:
            with pytest.raises(isodyn.InvalidRequestError, match="anchor") as caught:
                client.locate(surveyed.level_id, samples, prior=start_of(walk), aids=aids)
            assert caught.value.field == "gnss"
            client.update_venue(venue.id, anchor=isodyn.Anchor(latitude_deg=30.3, longitude_deg=120.1))
        with client.open_session(surveyed.level_id, prior=start_of(walk)) as session:
            results = list(session.send_all(samples, aids=aids, wait=20))
        assert [result.error for result in results] == [None] * len(results)
        assert len(client.locate(surveyed.level_id, samples, prior=start_of(walk), aids=aids).fixes) > 5
        assert len(session.trajectory()) > 5
        survey = client.create_survey(surveyed.level_id, "with beacons")
        client.add_walk(survey.id, "a", samples, isodyn.Waypoints(samples.t_ms[[0, -1]], [1, 9], [1, 9]), ble=aids.ble)


def test_jobs_methods_keys_stats(service: Service, surveyed: Surveyed) -> None:
    with service.client() as client:
        build = next(client.jobs(kind="build_map", state="done"))
        assert client.job(build.id) == build
        assert client.wait_for_job(build.id).result["map_id"]
        methods = {method.name: method for method in client.methods()}
        assert {"particle", "dead_reckoning"} <= set(methods)
        assert client.method("particle") == methods["particle"]
        assert [name for name, method in methods.items() if method.default] == ["particle"]
        particles = next(p for p in methods["particle"].parameters if p.name == "particles")
        assert particles.type == "integer"
        assert particles.minimum is not None
        assert particles.minimum <= particles.default
        key = client.create_key("contract", ["locate"])
        assert client.key(key.id).scopes == {isodyn.Scope.LOCATE}
        with isodyn.Client(service.url, key.secret) as weak, pytest.raises(isodyn.ForbiddenError):
            weak.create_survey(surveyed.level_id, "not allowed")
        assert client.current_key().scopes == {isodyn.Scope.ADMIN}
        client.revoke_key(key.id)
        with isodyn.Client(service.url, key.secret) as revoked, pytest.raises(isodyn.UnauthorizedError):
            list(revoked.venues())
        assert client.stats().maps >= 1
        client.ready()


def test_statistics_and_ground_truth(service: Service, surveyed: Surveyed, walk: RecordedWalk) -> None:
    with service.client() as client:
        with client.open_session(surveyed.level_id, prior=start_of(walk)) as session:
            list(session.send_all(samples_of(walk.samples), wait=20))
        fixes = client.positions(session.id)
        t_ms, x, y = (np.asarray(getattr(fixes, name))[::20] for name in ("t_ms", "x", "y"))
        made = client.add_ground_truth(session.id, t_ms, x + 0.5, y, sd_m=np.full(len(x), 0.2))
        told = list(client.ground_truth(session.id))
        assert tuple(told) == made.items
        assert [point.fix.error_m for point in told if point.fix] == pytest.approx([0.5] * len(t_ms), abs=0.02)
        span = {"since": min_time(t_ms), "until": datetime.now(UTC)}
        by_level = client.stats_table("accuracy", **span, level_id=surveyed.level_id, by=["level"])
        assert by_level.items[0]["fixes"] == "all"
        assert by_level.items[0]["n"] >= len(t_ms)
        rows = client.stats_csv("throughput", bucket="minute").decode().splitlines()
        assert rows[0].startswith("since,segments,")
        assert sum(row["segments"] for row in client.stats_table("throughput", bucket="hour").items) > 0
        assert surveyed.level_id in {level.level_id for level in client.level_stats()}
        assert {"backlog", "storage", "errors", "latency", "fixes"} == {
            name for name in ("backlog", "storage", "errors", "latency", "fixes") if client.stats_table(name)
        }
        assert isinstance(client.alarms().items, tuple)
        client.forget_ground_truth(session.id)
        assert list(client.ground_truth(session.id)) == []


def min_time(t_ms: np.ndarray) -> datetime:
    return datetime.fromtimestamp(float(t_ms[0]) / 1000 - 1, UTC)


def test_a_level_without_a_map(service: Service) -> None:
    with service.client() as client:
        level = client.create_level(client.create_venue("New").id, "F1", extent=(0, 0, 10, 10))
        with pytest.raises(isodyn.NoMapError):
            client.open_session(level.id)
        with pytest.raises(isodyn.ConflictError):
            client.request_map(level.id)


@pytest.mark.parametrize("kind", PROBLEM_TYPES, ids=lambda kind: kind.slug)
def test_every_problem_of_the_service_has_an_error(kind: ProblemType) -> None:
    answer = Problem(kind, "what happened", (FieldError("a.b", "is wrong", "put it right"),)).response("/v1/venues")
    error = problem_from(httpx.Response(answer.status_code, content=bytes(answer.body)))
    assert isinstance(error, isodyn.ProblemError)
    assert (error.slug, error.status, error.field, error.remedy) == (kind.slug, kind.status, "a.b", "put it right")
    assert (type(error) is isodyn.ProblemError) == (kind.slug == "method-not-allowed")


def test_every_call_of_the_api_has_a_method(service: Service) -> None:
    """A call added to the service is a call to add here."""
    paths = httpx.get(f"{service.url}/openapi.json", trust_env=False).json()["paths"]
    served = {(verb.upper(), path) for path, verbs in paths.items() for verb in verbs if path.startswith("/v1/")}
    served = {(verb, path) for verb, path in served if not path.startswith("/v1/ingest/")}  # doors of phones
    source = "".join(path.read_text() for path in Path(endpoints.__file__).parent.glob("*.py"))
    for verb, path in sorted(served):
        pattern = re.sub(r"^/v1/stats/.+", "/v1/stats/", path.split("{")[0])  # one call for all tables
        assert pattern.rstrip("/") in source, f"{verb} {path}"


@asynccontextmanager
async def in_process(folder: Path) -> AsyncIterator[isodyn.AsyncClient]:
    """A client of a service in this very process, without a socket."""
    settings = Settings(data_dir=folder / "data", pool="inline", log_level="warning")
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        database = Database.at(settings.database_path)
        _, key = AccountService(uow=database, clock=utc_now).create_key("tests", {Scope.ADMIN})
        transport = httpx.ASGITransport(app)
        async with isodyn.AsyncClient("http://in-process", key, transport=transport) as client:
            yield client
        database.close()


def test_the_async_client_in_process(tmp_path: Path, walk: RecordedWalk) -> None:
    async def run() -> None:
        async with in_process(tmp_path) as client:
            venue = await client.create_venue("Mall")
            level = await client.create_level(venue.id, "F2", extent=(0, 0, 240, 180))
            assert [one.id async for one in client.levels(venue_id=venue.id)] == [level.id]
            survey = await client.create_survey(level.id, "survey")
            await client.add_walk(survey.id, "a", samples_of(walk.samples), waypoints_of(walk.waypoints), gzip=True)
            info = await client.build_map(level.id, cell_m=1.0)
            raster = await client.map_field(info.id, "x")
            assert raster.values.shape == (info.rows, info.columns)
            async with await client.open_session(level.id, prior=start_of(walk)) as session:
                results = [result async for result in session.send_all(samples_of(walk.samples), wait=20)]
            assert all(result.fixes is not None for result in results)
            assert len(await session.positions()) > 10
            with pytest.raises(isodyn.NotFoundError):
                await client.venue("ven_0")

    asyncio.run(run())
