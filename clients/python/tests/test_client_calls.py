"""Both clients: calls, answers, lists, sessions, jobs, maps."""

from __future__ import annotations

import asyncio
import gzip
import inspect
import json
from typing import Any

import httpx
import msgpack
import numpy as np
import pytest
from conftest import FIXES, LAGGED, NOW, SESSION, VENUE, FakeService, job, make_samples, ok, problem, segment
from isodyn_client import (
    Aids,
    AsyncClient,
    BleScans,
    Client,
    Encoding,
    FixKind,
    GnssFixes,
    InvalidRequestError,
    IsodynError,
    JobFailedError,
    JobState,
    PressureReadings,
    Prior,
    Samples,
    SegmentResult,
    SequenceConflictError,
    Session,
    SpeedReadings,
    StepCounts,
    StillWaitingError,
    UnexpectedAnswerError,
    Waypoints,
    WifiScans,
)


def public_methods(cls: type) -> set[str]:
    return {name for name, value in vars(cls).items() if callable(value) and not name.startswith("_")}


def test_both_clients_offer_the_same() -> None:
    assert public_methods(Client) == public_methods(AsyncClient)
    for name in public_methods(Client):
        blocking, awaited = (inspect.signature(getattr(cls, name)) for cls in (Client, AsyncClient))
        assert list(blocking.parameters) == list(awaited.parameters), name


def test_methods_look_like_the_calls_they_are_made_of(client: Client) -> None:
    assert list(inspect.signature(client.create_venue).parameters) == ["name", "kind", "anchor"]
    assert next(iter(inspect.signature(client.build_map).parameters)) == "level_id"
    assert "local frame" in (client.create_venue.__doc__ or "")


def test_a_call_carries_the_key_and_gives_a_frozen_model(service: FakeService, client: Client) -> None:
    service.will(ok(VENUE | {"field_of_the_future": 1}, 201))
    venue = client.create_venue("Mall")
    request = service.requests[0]
    assert request.headers["Authorization"] == "Bearer isk_test"
    assert request.headers["Idempotency-Key"]
    assert json.loads(service.bodies[0]) == {"name": "Mall", "kind": "indoor"}
    assert request.headers["Content-Length"] == str(len(service.bodies[0]))
    assert (venue.id, venue.created_at.year) == ("ven_1", 2026)
    with pytest.raises(ValueError, match="frozen"):
        venue.name = "Other"  # type: ignore[misc]


def test_each_creation_has_its_own_idempotency_key(service: FakeService, client: Client) -> None:
    service.will(ok(VENUE), ok(VENUE))
    client.create_venue("Mall")
    client.create_venue("Mall")
    first, second = (request.headers["Idempotency-Key"] for request in service.requests)
    assert first != second


def test_the_key_is_not_shown(client: Client) -> None:
    assert "isk_test" not in repr(client) + repr(client.connection)


def test_address_and_key_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISODYN_URL", "http://elsewhere:9/")
    monkeypatch.setenv("ISODYN_KEY", "isk_env")
    with Client() as client:
        assert (client.connection.url, client.connection.key) == ("http://elsewhere:9", "isk_env")
    with Client("http://here", "isk_arg") as client:
        assert (client.connection.url, client.connection.key) == ("http://here", "isk_arg")


def test_lists_fetch_pages_when_needed(service: FakeService, client: Client) -> None:
    service.will(
        ok({"items": [VENUE, VENUE | {"id": "ven_2"}], "next_cursor": "ven_2"}),
        ok({"items": [VENUE | {"id": "ven_3"}], "next_cursor": None}),
    )
    venues = client.venues()
    assert service.requests == []
    assert next(venues).id == "ven_1"
    assert len(service.requests) == 1
    assert [venue.id for venue in venues] == ["ven_2", "ven_3"]
    assert service.requests[1].url.params["cursor"] == "ven_2"
    assert service.requests[1].url.params["limit"] == service.requests[0].url.params["limit"]


def test_async_lists_fetch_pages_too(service: FakeService) -> None:
    async def run() -> list[str]:
        async with service.async_client() as client:
            return [venue.id async for venue in client.venues()]

    service.will(ok({"items": [VENUE], "next_cursor": "c"}), ok({"items": [VENUE | {"id": "ven_2"}]}))
    assert asyncio.run(run()) == ["ven_1", "ven_2"]


def decoded(body: bytes) -> dict[str, Any]:
    value: dict[str, Any] = msgpack.unpackb(body)
    samples = value["samples"]
    samples["t_ms"] = np.frombuffer(samples["t_ms"], "<f8")
    for sensor in ("mag", "acc", "gyro"):
        samples[sensor] = {axis: np.frombuffer(column, "<f4") for axis, column in samples[sensor].items()}
    return value


@pytest.mark.parametrize("n", [1, 100, 40_000])
@pytest.mark.parametrize("compressed", [False, True])
def test_walks_arrive_as_they_were(service: FakeService, client: Client, n: int, compressed: bool) -> None:
    walk = {"id": "wlk_1", "survey_id": "srv_1", "name": "a", "n_samples": n, "n_waypoints": 2, "duration_s": 1.0}
    service.will(ok(walk | {"length_m": 1.0, "content_hash": "00", "created_at": NOW}, 201))
    samples = make_samples(n)
    points = Waypoints(samples.t_ms[[0, -1]], [1.5, 2.5], [0.1, 0.2])
    wifi = WifiScans([1.0], ["aa:bb"], [-60.0])
    client.add_walk("srv_1", "a", samples, points, wifi=wifi, gzip=compressed)
    headers, body = service.requests[0].headers, service.bodies[0]
    if compressed:
        assert headers["Content-Encoding"] == "gzip"
        body = gzip.decompress(body)
    else:
        assert headers["Content-Length"] == str(len(body))
    value = decoded(body)
    assert value["frame"] == "android"
    assert value["waypoints"] == {"t_ms": points.t_ms.tolist(), "x": [1.5, 2.5], "y": [0.1, 0.2]}
    assert value["wifi"] == {"t_ms": [1.0], "bssid": ["aa:bb"], "rssi": [-60.0]}
    np.testing.assert_array_equal(value["samples"]["t_ms"], samples.t_ms)
    for sensor in ("mag", "acc", "gyro"):
        for i, axis in enumerate("xyz"):
            expected = getattr(samples, sensor)[:, i].astype(np.float32)
            np.testing.assert_array_equal(value["samples"][sensor][axis], expected)


def test_json_says_the_same(service: FakeService, client: Client) -> None:
    service.will(ok(segment(0)))
    samples = make_samples(3)
    client.send_segment("ses_1", 0, samples, encoding=Encoding.JSON)
    value = json.loads(service.bodies[0])
    assert service.requests[0].headers["Content-Type"] == "application/json"
    assert value["seq"] == 0
    assert value["samples"]["acc"]["z"] == samples.acc[:, 2].tolist()
    assert "wifi" not in value


def test_fixes_come_out_as_arrays(service: FakeService, client: Client) -> None:
    service.will(ok(segment(0)))
    result = client.send_segment("ses_1", 0, make_samples(), wait=5)
    assert service.requests[0].headers["Prefer"] == "wait=5"
    assert isinstance(result, SegmentResult)
    fixes = result.fixes
    assert fixes is not None
    assert len(fixes) == 2
    np.testing.assert_array_equal(fixes.xy, [[1.0, 3.0], [2.0, 4.0]])
    np.testing.assert_array_equal(fixes.covariance[1], [[1.0, 0.5], [0.5, 2.0]])
    assert fixes.status == ("insufficient", "ok")
    assert fixes.sure.tolist() == [False, True]
    assert fixes.walk_on_m[0] == 12.5
    assert np.isnan(fixes.walk_on_m[1])


def test_the_clients_patience_grows_with_wait(service: FakeService, client: Client) -> None:
    service.will(ok(segment(0)), ok(segment(0)))
    client.send_segment("ses_1", 0, make_samples(5), wait=25)
    client.segment("ses_1", 0)
    patient, plain = (request.extensions["timeout"] for request in service.requests)
    assert patient["read"] == plain["read"] + 25
    assert patient["connect"] == plain["connect"]


def test_a_session_numbers_its_segments_and_closes(service: FakeService, client: Client) -> None:
    service.will(ok(SESSION, 201), *(ok(segment(seq), 202) for seq in range(3)), ok(SESSION | {"status": "closed"}))
    with client.open_session("lev_1", prior=Prior(x=1.0, y=2.0)) as session:
        results = list(session.send_all(make_samples(130), segment_s=1.0))
    assert [result.seq for result in results] == [0, 1, 2]
    sent = [decoded(body) for body in service.bodies[1:4]]
    assert [value["seq"] for value in sent] == [0, 1, 2]
    assert [len(value["samples"]["t_ms"]) for value in sent] == [50, 50, 30]
    assert json.loads(service.bodies[0])["prior"] == {"x": 1.0, "y": 2.0, "radius_m": 3.0}
    assert service.requests[-1].url.path == "/v1/sessions/ses_1/close"
    assert session.info.status == "closed"


def test_a_refused_segment_does_not_use_up_its_number(service: FakeService, client: Client) -> None:
    service.will(ok(SESSION | {"next_seq": 7}), problem(422, "invalid"), ok(segment(7)))
    session = client.resume_session("ses_1")
    with pytest.raises(InvalidRequestError):
        session.send(make_samples(5))
    assert session.next_seq == 7
    session.send(make_samples(6))
    assert session.next_seq == 8


def test_a_session_stays_open_after_an_error(service: FakeService, client: Client) -> None:
    service.will(ok(SESSION, 201), problem(409, "sequence-conflict"))
    with pytest.raises(SequenceConflictError), client.open_session("lev_1") as session:
        session.send(make_samples(5))
    assert len(service.requests) == 2  # no close
    assert isinstance(session, Session)


def test_async_sessions_do_the_same(service: FakeService) -> None:
    async def run() -> list[int]:
        async with service.async_client() as client, await client.open_session("lev_1") as session:
            return [result.seq async for result in session.send_all(make_samples(100), segment_s=1.0, wait=1)]

    service.will(ok(SESSION, 201), ok(segment(0)), ok(segment(1)), ok(SESSION))
    assert asyncio.run(run()) == [0, 1]
    assert service.requests[1].headers["Prefer"] == "wait=1"


def test_wifi_goes_with_the_segment_in_which_it_was_heard(service: FakeService, client: Client) -> None:
    samples = make_samples(100)
    t0 = samples.t_ms[0]
    wifi = WifiScans([t0 + 1500.0, t0 - 100.0, t0 + 980.0], ["late", "before", "first"], [-1.0, -2.0, -3.0])
    service.will(ok(SESSION), ok(segment(0)), ok(segment(1)))
    list(client.resume_session("ses_1").send_all(samples, aids=Aids(wifi=wifi), segment_s=1.0))
    heard = [decoded(body)["wifi"]["bssid"] for body in service.bodies[1:]]
    assert heard == [["before", "first"], ["late"]]


def every_aid(t0: float) -> Aids:
    t_ms = [t0 + 10.0, t0 + 1500.0]
    return Aids(
        wifi=WifiScans(t_ms, ["w", "w"], [-1.0, -2.0]),
        ble=BleScans(t_ms, ["b", "c"], [-70.0, -71.5]),
        gnss=GnssFixes(t_ms, [48.1, 48.2], [11.5, 11.6], [12.0, 4.5]),
        pressure=PressureReadings(t_ms, [953.25, 953.0]),
        speed=SpeedReadings(t_ms, [1.25, -0.5]),
        steps=StepCounts(t_ms, [5120.0, 5121.0]),
    )


@pytest.mark.parametrize("encoding", list(Encoding))
def test_all_aids_arrive_as_they_were(service: FakeService, client: Client, encoding: Encoding) -> None:
    samples = make_samples(100)
    t0 = float(samples.t_ms[0])
    service.will(ok(segment(0)), ok({"map_id": "map_1", "method": "particle", "fixes": FIXES, "fixed_lag": LAGGED}))
    client.send_segment("ses_1", 0, samples, aids=every_aid(t0), encoding=encoding)
    client.locate("lev_1", samples, aids=every_aid(t0), encoding=encoding)
    for body in service.bodies:
        value = json.loads(body) if encoding is Encoding.JSON else decoded(body)
        t_ms = [t0 + 10.0, t0 + 1500.0]
        assert value["wifi"] == {"t_ms": t_ms, "bssid": ["w", "w"], "rssi": [-1.0, -2.0]}
        assert value["ble"] == {"t_ms": t_ms, "address": ["b", "c"], "rssi": [-70.0, -71.5]}
        assert value["gnss"] == {
            "t_ms": t_ms, "latitude_deg": [48.1, 48.2], "longitude_deg": [11.5, 11.6], "accuracy_m": [12.0, 4.5]
        }  # fmt: skip
        assert value["pressure"] == {"t_ms": t_ms, "hpa": [953.25, 953.0]}
        assert value["speed"] == {"t_ms": t_ms, "speed_m_s": [1.25, -0.5]}
        assert value["steps"] == {"t_ms": t_ms, "count": [5120.0, 5121.0]}
        assert Aids.from_columns(value).columns() == every_aid(t0).columns()


def test_aids_go_with_their_segment_and_old_ones_stay_behind(service: FakeService, client: Client) -> None:
    """Of what is older than the samples the service takes 10 s, of Wi-Fi everything."""
    first, second = make_samples(50), make_samples(50, start_ms=1_764_000_060_000.0)
    t_ms = np.concatenate((first.t_ms, second.t_ms))
    samples = Samples(t_ms, *(np.concatenate((getattr(first, n), getattr(second, n))) for n in ("mag", "acc", "gyro")))
    at = first.t_ms[0] + np.array([-10_001.0, -9_999.0, 500.0, 30_000.0, 50_500.0, 60_500.0, 61_500.0])
    aids = Aids(wifi=WifiScans(at, list("abcdefg"), np.zeros(7)), pressure=PressureReadings(at, np.arange(7.0) + 950.0))
    service.will(ok(SESSION), ok(segment(0)), ok(segment(1)))
    list(client.resume_session("ses_1").send_all(samples, aids=aids, segment_s=10.0))
    values = [decoded(body) for body in service.bodies[1:]]
    assert [value["wifi"]["bssid"] for value in values] == [["a", "b", "c"], ["d", "e", "f"]]
    assert [value["pressure"]["hpa"] for value in values] == [[951.0, 952.0], [954.0, 955.0]]


def test_ble_goes_with_a_walk(service: FakeService, client: Client) -> None:
    walk = {"id": "wlk_1", "survey_id": "srv_1", "name": "a", "n_samples": 9, "n_waypoints": 2, "duration_s": 1.0}
    service.will(ok(walk | {"length_m": 1.0, "content_hash": "00", "created_at": NOW}, 201))
    samples = make_samples(9)
    points = Waypoints(samples.t_ms[[0, -1]], [1.5, 2.5], [0.1, 0.2])
    client.add_walk("srv_1", "a", samples, points, ble=BleScans([1.0], ["b"], [-60.0]))
    value = decoded(service.bodies[0])
    assert value["ble"] == {"t_ms": [1.0], "address": ["b"], "rssi": [-60.0]}
    assert "wifi" not in value


KNOWN = {"offset": [4.0, -7.5, 2.0], "offset_sd": [2.0, 2.0, 2.5], "stride_scale": 1.04, "stride_scale_sd": 0.04}
KNOWN |= {"soft_iron": [0.02, -0.03, 0.0, 0.01, 0.0, 0.01], "soft_iron_sd": [0.01, 0.01, 0.04, 0.01, 0.01, 0.01]}


def test_what_is_known_of_a_device(service: FakeService, client: Client) -> None:
    device = {"id": "dev_1", "name": "phone", "model": None, "created_at": NOW}
    memory = {**KNOWN, "epoch": "bias-1", "n_sessions": 3, "updated_at": NOW}
    service.will(ok(device, 201), ok(device | {"calibrations": [memory]}), httpx.Response(204))
    assert client.create_device("phone").calibrations == ()
    (known,) = client.device("dev_1").calibrations
    assert (known.epoch, known.n_sessions, known.offset, known.stride_scale) == ("bias-1", 3, (4.0, -7.5, 2.0), 1.04)
    assert (known.soft_iron, known.soft_iron_sd[2]) == ((0.02, -0.03, 0.0, 0.01, 0.0, 0.01), 0.04)
    client.forget_calibrations("dev_1")
    assert (service.requests[-1].method, service.requests[-1].url.path) == ("DELETE", "/v1/devices/dev_1/calibrations")


def test_a_session_names_device_and_epoch_and_tells_what_it_began_with(service: FakeService, client: Client) -> None:
    service.will(ok(SESSION, 201), ok(SESSION | {"calibration_epoch": "bias-1", "calibration": KNOWN}, 201))
    assert client.open_session("lev_1").info.calibration is None
    info = client.open_session("lev_1", device_id="dev_1", calibration_epoch="bias-1").info
    assert json.loads(service.bodies[0]) == {"level_id": "lev_1"}
    assert json.loads(service.bodies[1]) == {"level_id": "lev_1", "device_id": "dev_1", "calibration_epoch": "bias-1"}
    assert info.calibration is not None
    assert (info.calibration_epoch, info.calibration.offset_sd) == ("bias-1", (2.0, 2.0, 2.5))


def test_positions_are_gathered_from_all_pages(service: FakeService, client: Client) -> None:
    service.will(ok({"fixes": FIXES, "next_cursor": "2"}), ok({"fixes": FIXES, "next_cursor": None}))
    fixes = client.positions("ses_1")
    assert len(fixes) == 4
    assert fixes.status == ("insufficient", "ok", "insufficient", "ok")
    assert service.requests[1].url.params["cursor"] == "2"


def test_steps_told_once_more_come_with_a_segment(service: FakeService, client: Client) -> None:
    service.will(ok(SESSION, 201), ok(segment(0)), ok(segment(1, "queued"), 202))
    session = client.open_session("lev_1")
    result = session.send(make_samples(), wait=5)
    assert result.fixes is not None
    assert result.fixed_lag is not None
    assert result.fixes.kind == (FixKind.FILTERED, FixKind.FILTERED)
    assert result.fixed_lag.kind == (FixKind.FIXED_LAG,)
    np.testing.assert_array_equal(result.fixed_lag.xy, [[0.75, 3.0]])
    assert session.send(make_samples(start_ms=1_764_000_005_000.0)).fixed_lag is None


def test_positions_of_a_kind(service: FakeService, client: Client) -> None:
    service.will(ok(SESSION), *[ok({"fixes": LAGGED, "next_cursor": cursor}) for cursor in ("1", None)], ok({}), ok({}))
    fixes = client.resume_session("ses_1").positions(kind="fixed_lag")
    assert fixes.kind == (FixKind.FIXED_LAG,) * 2
    assert [request.url.params["kind"] for request in service.requests[1:]] == ["fixed_lag"] * 2
    client.positions_geojson("ses_1", kind=FixKind.FIXED_LAG)
    assert service.requests[-1].url.params["kind"] == "fixed_lag"
    client.positions_geojson("ses_1")
    assert "kind" not in service.requests[-1].url.params


def test_positions_of_a_kind_awaited(service: FakeService) -> None:
    async def run() -> tuple[FixKind, ...]:
        async with service.async_client() as client:
            session = await client.resume_session("ses_1")
            return (await session.positions(seq=1, kind=FixKind.FIXED_LAG)).kind

    service.will(ok(SESSION), ok({"fixes": LAGGED, "next_cursor": None}))
    assert asyncio.run(run()) == (FixKind.FIXED_LAG,)
    assert dict(service.requests[1].url.params) == {"seq": "1", "kind": "fixed_lag", "limit": "500"}


TRAJECTORY = {"session_id": "ses_1", "map_id": "map_1", "method": "particle", "kind": "smoothed", "fixes": FIXES}


def test_the_trajectory_of_a_session_is_arrays(service: FakeService, client: Client) -> None:
    service.will(ok(SESSION), ok(TRAJECTORY), ok(TRAJECTORY | {"kind": "causal"}))
    session = client.resume_session("ses_1")
    fixes = session.trajectory()
    assert service.requests[1].url.path == "/v1/sessions/ses_1/trajectory"
    np.testing.assert_array_equal(fixes.xy, [[1.0, 3.0], [2.0, 4.0]])
    with pytest.raises(UnexpectedAnswerError):
        client.trajectory("ses_1")


def test_the_trajectory_awaited(service: FakeService) -> None:
    async def run() -> int:
        async with service.async_client() as client:
            session = await client.resume_session("ses_1")
            return len(await session.trajectory())

    service.will(ok(SESSION), ok(TRAJECTORY))
    assert asyncio.run(run()) == 2


MAP = {
    "id": "map_1", "level_id": "lev_1", "version": 3, "hash": "ab", "features": "vector", "x0": 0.0, "y0": 1.0,
    "cell_m": 0.5, "rows": 2, "columns": 3, "mapped_m": 1.5, "noise_sd": [1, 1, 1], "mapped_share": 0.4,
    "mapped_area_m2": 100.0, "n_walks": 5, "n_samples": 1000, "length_scale_m": 2.5, "field_sd": [5, 5, 5],
    "walks": [], "build_s": 1.0, "created_at": NOW,
}  # fmt: skip


def test_building_a_map_waits_and_tells_how_far_it_is(service: FakeService, client: Client) -> None:
    service.will(
        ok(job("queued"), 202),
        ok(job("running", 0.5)),
        ok(job("done", 1.0, result={"map_id": "map_1"})),
        ok(MAP),
    )
    seen: list[float] = []
    info = client.build_map("lev_1", cell_m=0.5, progress=lambda job: seen.append(job.progress))
    assert (info.version, seen) == (3, [0.5, 1.0])
    assert json.loads(service.bodies[0]) == {"level_id": "lev_1", "cell_m": 0.5}
    assert len(service.pauses) == 1


def test_walks_are_taken_as_they_are_on_request(service: FakeService, client: Client) -> None:
    service.will(ok(job("queued"), 202))
    client.request_map("lev_1", align=False)
    assert json.loads(service.bodies[0]) == {"level_id": "lev_1", "align": False}


def test_a_failed_job_is_an_error_with_the_job(service: FakeService, client: Client) -> None:
    service.will(ok(job("failed", error="too few samples")))
    with pytest.raises(JobFailedError, match="too few samples") as caught:
        client.wait_for_job("job_1")
    assert caught.value.job.state is JobState.FAILED


def test_waiting_ends(service: FakeService, client: Client) -> None:
    service.will(ok(job("running")))
    with pytest.raises(StillWaitingError):
        client.wait_for_job("job_1", timeout=0.0)


def test_a_map_field_is_an_array(service: FakeService, client: Client) -> None:
    values = np.array([[1, 2, np.nan], [4, 5, 6]], dtype="<f4")
    headers = {"X-Isodyn-Rows": "2", "X-Isodyn-Columns": "3", "X-Isodyn-X0": "10", "X-Isodyn-Y0": "-1"}
    service.will(httpx.Response(200, content=values.tobytes(), headers={**headers, "X-Isodyn-Cell-M": "0.5"}))
    raster = client.map_field("map_1", "z", statistic="sd")
    assert dict(service.requests[0].url.params) == {"channel": "z", "statistic": "sd", "format": "f32"}
    np.testing.assert_array_equal(raster.values, values)
    assert raster.extent == (10.0, -1.0, 11.0, -0.5)
    assert raster.at(10.6, -0.6) == 5.0
    assert np.isnan(raster.at(9.0, 0.0))


def test_a_field_of_the_wrong_size_is_not_an_array(service: FakeService, client: Client) -> None:
    headers = {"X-Isodyn-Rows": "2", "X-Isodyn-Columns": "3", "X-Isodyn-X0": "0", "X-Isodyn-Y0": "0"}
    service.will(httpx.Response(200, content=b"123", headers={**headers, "X-Isodyn-Cell-M": "0.5"}))
    with pytest.raises(UnexpectedAnswerError):
        client.map_field("map_1", "z")


def test_a_map_as_a_file(service: FakeService, client: Client) -> None:
    service.will(httpx.Response(200, content=b"CDF..."))
    assert client.export_map("map_1", format="netcdf", licence="CC0") == b"CDF..."
    request = service.requests[0]
    assert (request.method, request.url.path) == ("GET", "/v1/maps/map_1/export")
    assert dict(request.url.params) == {"format": "netcdf", "licence": "CC0"}


def test_a_file_as_a_map(service: FakeService) -> None:
    async def run() -> str:
        async with service.async_client() as client:
            made = await client.import_map(
                "lvl_1", b"grid" * 100, format="esri-ascii", channel="total", sd=1.5, publish=False
            )
            assert made.origin is not None
            return made.origin.assumed[0]

    origin = {"source": "import", "format": "esri-ascii", "file_hash": "0f", "assumed": ["no unit"]}
    service.will(ok(MAP | {"origin": origin}, 201))
    assert asyncio.run(run()) == "no unit"
    request = service.requests[0]
    assert request.url.path == "/v1/levels/lvl_1/maps/import"
    sent = {"format": "esri-ascii", "channel": "total", "sd": "1.5", "publish": "false"}
    assert dict(request.url.params) == sent
    assert request.headers["Content-Encoding"] == "gzip"
    assert gzip.decompress(service.bodies[0]) == b"grid" * 100


def test_an_import_is_not_sent_twice(service: FakeService, client: Client) -> None:
    service.will(httpx.ReadError("gone"))
    with pytest.raises(IsodynError):
        client.import_map("lvl_1", b"grid", format="xyz")
    assert len(service.requests) == 1


def test_a_survey_as_a_file(service: FakeService, client: Client) -> None:
    service.will(httpx.Response(200, content=b"PK"), httpx.Response(200, content=b"PK"))
    assert client.export_survey("srv_1") == b"PK"
    assert not service.requests[0].url.params
    client.export_survey("srv_1", radio=True)
    assert dict(service.requests[1].url.params) == {"radio": "true"}


def test_coverage_is_a_mask(service: FakeService, client: Client) -> None:
    place = {"rows": 2, "columns": 4, "x0": 0.0, "y0": 0.0, "cell_m": 0.5, "mapped_m": 1.5}
    shares = {"mapped_share": 0.5, "mapped_area_m2": 1.0}
    service.will(ok(place | shares | {"runs": [1, 3, 3, 1]}), ok(place | shares | {"runs": [1, 3]}))
    coverage = client.map_coverage("map_1")
    assert coverage.mapped.tolist() == [[False, True, True, True], [False, False, False, True]]
    with pytest.raises(UnexpectedAnswerError):
        client.map_coverage("map_1")


def test_quality_of_a_map(service: FakeService, client: Client) -> None:
    values = np.array([[0.5, np.nan]], dtype="<f4")
    headers = {"X-Isodyn-Rows": "1", "X-Isodyn-Columns": "2", "X-Isodyn-X0": "0", "X-Isodyn-Y0": "0"}
    service.will(httpx.Response(200, content=values.tobytes(), headers={**headers, "X-Isodyn-Cell-M": "1"}))
    raster = client.quality_raster("map_1", "across", heading_deg=45)
    assert dict(service.requests[0].url.params) == {"layer": "across", "heading_deg": "45", "format": "f32"}
    np.testing.assert_array_equal(raster.values, values)
    service.will(httpx.Response(200, content=b"png"))
    assert client.quality_image("map_1") == b"png"
    assert dict(service.requests[1].url.params) == {"layer": "mean_error", "format": "png"}


def test_suggestions_and_forecasts(service: FakeService, client: Client) -> None:
    line = {"start": [0, 1], "end": [2, 3], "length_m": 2.8, "gain_m2": 9.0, "reasons": ["thin"], "words": "few walks"}
    service.will(ok({"map_id": "map_1", "unknown_before": 0.5, "unknown_after": 0.4, "suggestions": [line]}))
    (found,) = client.survey_suggestions("map_1", count=3).suggestions
    assert (found.start, found.reasons) == ((0.0, 1.0), ("thin",))
    assert dict(service.requests[0].url.params) == {"count": "3"}
    service.will(httpx.Response(200, content=b"{}"))
    assert client.suggestions_geojson("map_1") == b"{}"
    assert service.requests[1].headers["Accept"] == "application/geo+json"
    columns = {name: [0.0] for name in ("way_m", "x", "y", "along_m", "across_m", "error_m")}
    rest = {"map_id": "map_1", "length_m": 1, "mapped_share": 1, "mean_m": 1, "p90_m": 1, "stretches": []}
    service.will(ok({**columns, **rest, "mapped": [True]}))
    assert client.forecast_route("map_1", [(0, 1), (2, 3)]).mapped == (True,)
    assert json.loads(service.requests[2].content) == {"route": {"x": [0.0, 2.0], "y": [1.0, 3.0]}}


def test_another_service_is_not_understood(service: FakeService, client: Client) -> None:
    service.will(httpx.Response(200, text="<html>"))
    with pytest.raises(UnexpectedAnswerError, match="does not answer like Isodyn"):
        client.venue("ven_1")
