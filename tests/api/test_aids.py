"""Aids through HTTP: what is refused and why, and that what is sent arrives at the tracker, bit for bit."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from app.engine.types import Answer, DeviceCalibration, GridMap, MapSource, Prior, Segment, TrackerState
from app.services.aids import RADIUS_68_SD, Aids
from app.services.errors import InvalidError
from app.services.records import JobKind, JobState
from app.services.tasks import LocateSpec
from app.workers import tasks
from app.workers.tasks import LocateSegment
from tests.api.harness import Api, aid_columns, as_msgpack, plain, segment_body, walk_body
from tests.api.test_bad_input import Change, There, as_json, assert_refused, at, named
from tests.support.builders import T0, all_aids, calibration, fix

NAMES = tuple(field.name for field in fields(Aids))
START_MS = T0 * 1000.0


def body_with(change: Change | None = None, **values: Any) -> dict[str, Any]:
    body = {**segment_body(0), **aid_columns(all_aids()), **values}
    if change is not None:
        change(body)
    return body


def shift(name: str, ms: float) -> Change:
    return at(f"{name}.t_ms", lambda t: t + ms)


def scale(path: str, factor: float) -> Change:
    return at(path, lambda column: column * factor)


LENGTHS = [
    (f"{name}.{column} too short", at(f"{name}.{column}", lambda c: c[:-1]), f"{name}.{column}", f"{name}.t_ms has 3")
    for name, column in (
        ("ble", "address"), ("ble", "rssi"), ("gnss", "latitude_deg"), ("gnss", "longitude_deg"),
        ("gnss", "accuracy_m"), ("pressure", "hpa"), ("speed", "speed_m_s"), ("steps", "count"),
    )
]  # fmt: skip
BOUND = ("ble", "gnss", "pressure", "speed", "steps")
ORDERED = ("gnss", "pressure", "speed", "steps")
CASES = [
    *((*case, "every column") for case in LENGTHS),
    *((f"{n} too early", shift(n, -10_251.0), f"{n}.t_ms", "reading 0", "same clock") for n in BOUND),
    *((f"{n} too late", shift(n, 10_900.0), f"{n}.t_ms", "reading 2", "same clock") for n in BOUND),
    *((f"{n} in seconds", scale(f"{n}.t_ms", 1e-3), f"{n}.t_ms", "looks like seconds", "by 1000") for n in BOUND),
    *((f"{n} in ns", scale(f"{n}.t_ms", 1e6), f"{n}.t_ms", "looks like ns", "by 1000000") for n in BOUND),
    *((f"{n} NaN in time", at(f"{n}.t_ms.1", np.nan), f"{n}.t_ms", "value 1 is NaN", "finite") for n in BOUND),
    *((f"{n} backwards", at(f"{n}.t_ms", lambda t: t[::-1]), f"{n}.t_ms", "backwards", "time order") for n in ORDERED),
    *((f"{n} unknown field", at(f"{n}.sats", [1.0]), f"{n}.sats", "not permitted", "unknown fields") for n in NAMES),
    ("BLE in mW", at("ble.rssi.1", 1e3), "ble.rssi", "value 1 is 1000 dBm", "-150 to 20"),
    ("BLE address that is a number", at("ble.address.2", 7), "ble.address", "value 2", "strings"),
    ("latitude of 91", at("gnss.latitude_deg.1", 91.0), "gnss.latitude_deg", "value 1 is 91 degrees", "-90 to 90"),
    ("degrees times 1e7", scale("gnss.longitude_deg", 1e7), "gnss.longitude_deg", "value 0", "-180 to 180"),
    ("accuracy of 0", at("gnss.accuracy_m.2", 0.0), "gnss.accuracy_m", "value 2 is 0 m", "68 % radius"),
    ("accuracy NaN", at("gnss.accuracy_m.0", np.nan), "gnss.accuracy_m", "value 0 is nan m", "leave fixes"),
    ("Pa", scale("pressure.hpa", 100.0), "pressure.hpa", "looks like Pa", "divide by 100"),
    ("kPa", scale("pressure.hpa", 0.1), "pressure.hpa", "looks like kPa", "multiply by 10"),
    ("one odd pressure", at("pressure.hpa.1", 10.0), "pressure.hpa", "value 1 is 10 hPa", "300 to 1200"),
    ("faster than sound, almost", at("speed.speed_m_s.0", 201.0), "speed.speed_m_s", "value 0 is 201 m/s", "200"),
    ("steps that fall", at("steps.count.2", 5119.0), "steps.count", "falls from 5120 to 5119 at value 2", "reset"),
    ("half steps", at("steps.count.1", 5120.5), "steps.count", "value 1 is 5120.5, no whole", "as it reads"),
    ("steps below 0", at("steps.count.0", -1.0), "steps.count", "value 0 is -1", "from 0"),
    ("steps NaN", at("steps.count.0", np.nan), "steps.count", "value 0 is nan", "from 0"),
]  # fmt: skip


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Any:
    api = Api(tmp_path_factory.mktemp("aids"))
    created = api.ok("POST", "/v1/sessions", json={"level_id": api.anchored_level().id})
    yield api, f"/v1/sessions/{created['id']}/segments"
    api.close()


@named(CASES)
@pytest.mark.parametrize("encode", [as_json, as_msgpack])
def test_refused(
    session: There, change: Change, field: str, message: str, remedy: str, encode: Callable[..., Any]
) -> None:
    api, path = session
    before = api.stored()
    assert_refused(api, api.post(path, **encode(body_with(change))), before, field, message, remedy)


@pytest.mark.parametrize(("name", "most"), [("ble", 50_000), ("gnss", 10_000), ("steps", 10_000)])
def test_too_many_rows(session: There, name: str, most: int) -> None:
    api, path = session
    column = {key: np.zeros(most + 1) for key in aid_columns(all_aids())[name]}
    if name == "ble":
        column["address"] = ["a"] * (most + 1)  # type: ignore[assignment]
    response = api.post(path, **as_msgpack(body_with(**{name: column})))
    assert_refused(api, response, api.stored(), f"{name}.t_ms", f"has {most + 1} rows", f"at most {most}")


def test_readings_may_lie_a_little_outside_and_wifi_may_be_older(api: Api) -> None:
    created = api.ok("POST", "/v1/sessions", json={"level_id": api.anchored_level().id})
    body = body_with()
    for name in BOUND:
        body[name]["t_ms"] = START_MS + np.array([-10_000.0, 0.0, 4_980.0 + 10_000.0])
    body["wifi"]["t_ms"] -= 60_000.0
    api.ok("POST", f"/v1/sessions/{created['id']}/segments", **as_msgpack(body))


@pytest.mark.parametrize("call", ["segments", "locate"])
def test_gnss_needs_the_venues_anchor(api: Api, call: str) -> None:
    level = api.anchored_level(None)
    path = "/v1/locate"
    body = body_with()
    if call == "segments":
        path = f"/v1/sessions/{api.ok('POST', '/v1/sessions', json={'level_id': level.id})['id']}/segments"
    else:
        del body["seq"]
        body["level_id"] = level.id
    before = api.stored()
    assert_refused(api, api.post(path, **as_json(body)), before, "gnss", "no anchor", "PATCH /v1/venues/{venue_id}")
    del body["gnss"]
    assert api.post(path, **as_json(body)).is_success


def test_gnss_of_another_country_is_refused(session: There) -> None:
    api, path = session
    swapped = body_with(at("gnss.latitude_deg", np.array([11.5691, 11.5692, 11.5693])))
    swapped["gnss"]["longitude_deg"] = np.array([48.1507, 48.1508, 48.1509])
    before = api.stored()
    response = api.post(path, **as_json(swapped))
    assert_refused(api, response, before, "gnss.latitude_deg", "more than 1000 km from", "each under its name")
    opposite = body_with(at("gnss.latitude_deg", lambda c: -c))
    opposite["gnss"]["longitude_deg"] = opposite["gnss"]["longitude_deg"] - 180.0
    assert_refused(api, api.post(path, **as_json(opposite)), before, "gnss.latitude_deg", "fix 0", "anchor")


class Tracker:
    """Remembers the segments of its steps."""

    method = "particle"

    def __init__(self) -> None:
        self.taken: list[Segment] = []

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        return TrackerState(self.method, b"", None)

    def answer(self, state: TrackerState, segment: Segment, maps: MapSource) -> Answer:
        self.taken.append(segment)
        after = TrackerState(self.method, b"x", float(segment.samples.t[-1]))
        return Answer(after, (fix(float(segment.samples.t[0])),))

    def learned(self, state: TrackerState) -> DeviceCalibration | None:
        return calibration() if state.payload == b"x" else None


@pytest.fixture
def tracker(monkeypatch: pytest.MonkeyPatch) -> Tracker:
    made = Tracker()
    monkeypatch.setattr(tasks, "create_tracker", lambda method, parameters: made)
    return made


def no_map(_: object) -> GridMap:
    raise AssertionError("nobody asks for the map here")


def locate(spec: LocateSpec) -> Any:
    """As a worker process does: the spec and the result cross a pickle."""
    task = LocateSegment(no_map)
    return pickle.loads(pickle.dumps(task(pickle.loads(pickle.dumps(spec)), lambda *_: None)))


def assert_arrived(segment: Segment, sent: Aids) -> None:
    """Every reading bit for bit; satellite fixes in the level frame."""
    for name in ("wifi", "ble", "pressure", "speed", "steps"):
        taken, given = getattr(segment, name), getattr(sent, name)
        for field in fields(given):
            a, b = getattr(taken, field.name), getattr(given, field.name)
            if field.name == "address":
                assert a == b
            else:
                assert a.dtype == np.float64
                assert a.tobytes() == b.tobytes(), f"{name}.{field.name}"
    assert segment.gnss is not None
    assert sent.gnss is not None
    assert segment.gnss.t.tobytes() == sent.gnss.t.tobytes()
    assert segment.gnss.sd.tobytes() == (sent.gnss.accuracy_m / RADIUS_68_SD).tobytes()
    # metres from the anchor at (48.1507, 11.5691), whose +y points 12.5 degrees east of north
    north, east = 111_200.0 * (sent.gnss.latitude_deg - 48.1507), 74_250.0 * (sent.gnss.longitude_deg - 11.5691)
    turn = np.radians(12.5)
    np.testing.assert_allclose(segment.gnss.x, east * np.cos(turn) - north * np.sin(turn), atol=0.2)
    np.testing.assert_allclose(segment.gnss.y, east * np.sin(turn) + north * np.cos(turn), atol=0.2)


@pytest.mark.parametrize("encode", [as_json, as_msgpack])
def test_what_a_segment_brings_arrives_at_the_tracker(api: Api, tracker: Tracker, encode: Callable[..., Any]) -> None:
    session_id = api.ok("POST", "/v1/sessions", json={"level_id": api.anchored_level().id})["id"]
    api.worker.idle = True
    api.ok("POST", f"/v1/sessions/{session_id}/segments", **encode(body_with()))
    (job,) = api.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    result = locate(api.services.processing.locate_spec(job))
    assert result.calibration == calibration()
    done = api.services.processing.complete_locate(job, result)
    assert done is not None
    assert done.state is JobState.DONE
    (segment,) = tracker.taken
    assert_arrived(segment, all_aids())
    plain_body = segment_body(1)
    api.ok("POST", f"/v1/sessions/{session_id}/segments", **encode(plain_body))
    (job,) = api.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    locate(api.services.processing.locate_spec(job))
    assert all(getattr(tracker.taken[1], name) is None for name in NAMES)


@pytest.mark.parametrize("encode", [as_json, as_msgpack])
def test_what_a_one_shot_request_brings_arrives_at_the_worker(
    make_api: Callable[..., Api], monkeypatch: pytest.MonkeyPatch, encode: Callable[..., Any]
) -> None:
    api = make_api()
    taken: list[Segment] = []
    service = api.services.locate
    answer = service._task

    def remember(spec: LocateSpec, progress: Any) -> Any:
        taken.append(spec.segment)
        return answer(spec, progress)

    monkeypatch.setattr(service, "_task", remember)
    body = body_with(level_id=api.anchored_level().id)
    del body["seq"]
    api.ok("POST", "/v1/locate", **encode(body))
    assert_arrived(taken[0], all_aids())


def test_a_smoother_gets_them_too(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    level = api.anchored_level()
    session_id = api.ok("POST", "/v1/sessions", json={"level_id": level.id})["id"]
    api.ok("POST", f"/v1/sessions/{session_id}/segments", **as_msgpack(body_with()))
    taken: list[Segment] = []
    service = api.services.trajectories
    answer = service._task

    def remember(spec: Any, progress: Any) -> Any:
        taken.extend(spec.segments)
        return answer(spec, progress)

    monkeypatch.setattr(service, "_task", remember)
    api.ok("GET", f"/v1/sessions/{session_id}/trajectory")
    assert_arrived(taken[0], all_aids())
    venue = api.services.venues.get(level.venue_id)
    api.services.venues.update(venue.id, venue.name, None)
    response = api.get(f"/v1/sessions/{session_id}/trajectory")
    assert response.status_code == 409
    assert response.json()["errors"][0]["field"] == "gnss"
    assert "set the venue's anchor" in response.json()["errors"][0]["remedy"]


def test_the_same_aids_are_the_same_segment_however_they_are_sent(api: Api) -> None:
    session_id = api.ok("POST", "/v1/sessions", json={"level_id": api.anchored_level().id})["id"]
    path = f"/v1/sessions/{session_id}/segments"
    api.ok("POST", path, **as_json(body_with()))
    assert api.post(path, **as_msgpack(body_with())).headers["Isodyn-Repeated"] == "true"
    for name in NAMES:
        less = body_with()
        del less[name]
        assert api.post(path, **as_json(less)).status_code == 409, name
        column = "rssi" if name in ("wifi", "ble") else list(less_columns(name))[-1]
        other = body_with(at(f"{name}.{column}", lambda c: c + 1.0))
        assert api.post(path, **as_json(other)).status_code == 409, name


def less_columns(name: str) -> dict[str, Any]:
    columns: dict[str, Any] = aid_columns(all_aids())[name]
    return columns


def test_aids_without_rows_are_none(api: Api) -> None:
    session_id = api.session_id()  # no anchor: gnss would be refused
    path = f"/v1/sessions/{session_id}/segments"
    empty = {name: {column: [] for column in columns} for name, columns in aid_columns(all_aids()).items()}
    api.ok("POST", path, json=plain({**segment_body(0), **empty}))
    assert api.post(path, json=plain(segment_body(0))).headers["Isodyn-Repeated"] == "true"
    assert api.post(path, json=plain({**segment_body(0), **dict.fromkeys(NAMES)})).headers["Isodyn-Repeated"] == "true"


@pytest.mark.parametrize("encode", [as_json, as_msgpack])
def test_ble_of_a_survey_walk_reaches_the_build(api: Api, encode: Callable[..., Any]) -> None:
    level = api.level()
    survey_id = api.ok("POST", "/v1/surveys", json={"level_id": level.id, "name": "s"})["id"]
    sent = all_aids()
    body = {**walk_body(), **{name: aid_columns(sent)[name] for name in ("wifi", "ble")}}
    api.ok("POST", f"/v1/surveys/{survey_id}/walks", **encode(body))
    api.worker.idle = True
    api.ok("POST", "/v1/maps", json={"level_id": level.id})
    (job,) = api.services.processing.claim(1, JobKind.BUILD_MAP)
    (new,) = pickle.loads(pickle.dumps(api.services.processing.build_spec(job))).walks
    walk = new.walk
    for name in ("wifi", "ble"):
        taken, given = getattr(walk, name), getattr(sent, name)
        assert taken.address == given.address
        assert (taken.t.tobytes(), taken.rssi.tobytes()) == (given.t.tobytes(), given.rssi.tobytes())
    other = {**body, "ble": {**body["ble"], "rssi": body["ble"]["rssi"] - 1.0}}
    assert api.post(f"/v1/surveys/{survey_id}/walks", **encode(body)).status_code == 200
    assert api.post(f"/v1/surveys/{survey_id}/walks", **encode(other)).status_code == 201


def test_ble_of_a_walk_is_checked(api: Api) -> None:
    survey_id = api.ok("POST", "/v1/surveys", json={"level_id": api.level().id, "name": "s"})["id"]
    body = {**walk_body(), "ble": aid_columns(all_aids())["ble"]}
    body["ble"]["t_ms"] = body["ble"]["t_ms"] / 1000.0
    before = api.stored()
    response = api.post(f"/v1/surveys/{survey_id}/walks", **as_json(body))
    assert_refused(api, response, before, "ble.t_ms", "looks like seconds", "multiply by 1000")


def test_a_segment_whose_venue_lost_its_anchor_fails_alone(api: Api) -> None:
    level = api.anchored_level()
    session_id = api.ok("POST", "/v1/sessions", json={"level_id": level.id})["id"]
    api.worker.idle = True
    api.ok("POST", f"/v1/sessions/{session_id}/segments", **as_msgpack(body_with()))
    venue = api.services.venues.get(level.venue_id)
    api.services.venues.update(venue.id, venue.name, None)
    (job,) = api.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    with pytest.raises(InvalidError, match="set the venue's anchor"):  # which the runner stores as the job's error
        api.services.processing.locate_spec(job)
