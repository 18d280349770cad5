"""JSON and msgpack say the same; frames turn into one another; hashes follow the content."""

from __future__ import annotations

import msgpack
import numpy as np
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from app.api.frames import RULES, to_android
from app.api.schemas.samples import Frame, SegmentIn, WalkIn
from app.api.uploads import new_segment, new_walk, parse
from app.engine.types import Float64Array
from app.services.records import NewSegment
from tests.api.harness import JSON_TYPE, MSGPACK_TYPE, columns, packed, plain, segment_body, walk_body
from tests.support.builders import START, samples

EXTENT = (-100.0, -100.0, 100.0, 100.0)


@st.composite
def segments(draw: st.DrawFn) -> dict[str, object]:
    """Plausible segments of any length, rate and readings (float32, as phones have them)."""
    n = draw(st.integers(1, 60))
    steps = draw(npst.arrays(np.float64, n, elements=st.floats(0.5, 120.0)))
    t_ms = draw(st.floats(9.5e11, 1.79e12)) + np.cumsum(steps)
    t_ms = t_ms[np.concatenate(([True], np.diff(t_ms) > 0))] * 1.0
    n = len(t_ms)

    def sensor(spread: float, z: float) -> dict[str, Float64Array]:
        element = st.floats(-spread, spread, width=32)
        xyz = [draw(npst.arrays(np.float32, n, elements=element)).astype(np.float64) for _ in "xyz"]
        return dict(zip("xyz", (xyz[0], xyz[1], (xyz[2] + z).astype(np.float32).astype(np.float64)), strict=True))

    vectors = {"mag": sensor(60.0, -200.0), "acc": sensor(3.0, 9.75), "gyro": sensor(1.5, 2.0)}
    wifi = draw(st.none() | st.just({"t_ms": t_ms[:1], "bssid": ["02:00"], "rssi": np.array([-40.5])}))
    return {"seq": draw(st.integers(0, 2**31 - 1)), "samples": {"t_ms": t_ms, **vectors}, "wifi": wifi}


def from_json(body: dict[str, object]) -> NewSegment:
    return new_segment(parse(orjson.dumps(plain(body)), JSON_TYPE, SegmentIn), START)


def from_msgpack(body: dict[str, object], *, binary: bool = True) -> NewSegment:
    value = packed(body) if binary else plain(body)
    return new_segment(parse(msgpack.packb(value), MSGPACK_TYPE, SegmentIn), START)


def assert_same(a: NewSegment, b: NewSegment) -> None:
    assert a.content_hash == b.content_hash
    assert a.seq == b.seq
    for name in ("t", "mag", "acc", "gyro"):
        np.testing.assert_array_equal(getattr(a.samples, name), getattr(b.samples, name))


@settings(max_examples=60, deadline=None)
@given(body=segments())
def test_encodings_are_equivalent(body: dict[str, object]) -> None:
    reference = from_json(body)
    assert_same(reference, from_msgpack(body))
    assert_same(reference, from_msgpack(body, binary=False))


@settings(max_examples=60, deadline=None)
@given(body=segments())
def test_what_is_sent_is_what_is_taken(body: dict[str, object]) -> None:
    taken = from_msgpack(body)
    sent = body["samples"]
    assert isinstance(sent, dict)
    np.testing.assert_allclose(taken.samples.t * 1000.0, sent["t_ms"], rtol=0, atol=1e-3)
    for name in ("mag", "acc", "gyro"):
        expected = np.stack([sent[name][axis] for axis in "xyz"], axis=1)
        np.testing.assert_array_equal(getattr(taken.samples, name), expected)


@pytest.mark.parametrize("change", ["t", "mag", "acc", "gyro", "wifi"])
def test_the_hash_sees_every_column(change: str) -> None:
    body = segment_body(wifi={"t_ms": np.array([1.0]), "bssid": ["a"], "rssi": np.array([-40.0])})
    before = from_json(body).content_hash
    if change == "t":
        body["samples"]["t_ms"][-1] += 1.0
    elif change == "wifi":
        body["wifi"]["bssid"] = ["b"]
    else:
        body["samples"][change]["z"][17] += 0.25
    assert from_json(body).content_hash != before


def test_the_hash_does_not_see_the_number() -> None:
    assert from_json(segment_body()).content_hash == from_json({**segment_body(), "seq": 5}).content_hash


def test_an_empty_scan_is_no_scan() -> None:
    nothing: dict[str, object] = {"t_ms": [], "bssid": [], "rssi": []}
    assert from_json({**segment_body(), "wifi": nothing}).aids.wifi is None
    assert from_json({**segment_body(), "wifi": nothing}).content_hash == from_json(segment_body()).content_hash


def test_waypoints_count_in_the_hash_of_a_walk() -> None:
    body = walk_body()
    first = new_walk(parse(orjson.dumps(plain(body)), JSON_TYPE, WalkIn), EXTENT, START)
    assert (
        first.content_hash
        == new_walk(parse(msgpack.packb(packed(body)), MSGPACK_TYPE, WalkIn), EXTENT, START).content_hash
    )
    body["waypoints"]["x"][1] += 0.01
    assert (
        new_walk(parse(orjson.dumps(plain(body)), JSON_TYPE, WalkIn), EXTENT, START).content_hash != first.content_hash
    )


class TestFrames:
    vectors = npst.arrays(np.float64, (3, 5), elements=st.floats(-100, 100, width=32))

    @pytest.mark.parametrize("frame", list(Frame))
    def test_every_frame_is_a_proper_rotation(self, frame: Frame) -> None:
        matrix = to_android(np.eye(3), frame).T
        np.testing.assert_array_equal(matrix @ matrix.T, np.eye(3))
        assert np.linalg.det(matrix) == pytest.approx(1.0)
        assert set(RULES) == set(Frame)

    def test_the_same_posture_reads_alike(self) -> None:
        """A device lies flat, its top edge forward; it turns left and something magnetic is ahead, right and above."""
        right, forward, up = 3.0, 5.0, 7.0
        field = {
            Frame.ANDROID: (right, forward, up),
            Frame.IOS: (right, forward, up),
            Frame.FRD: (forward, right, -up),
            Frame.FLU: (forward, -right, up),
        }
        at_rest = {
            Frame.ANDROID: (0.0, 0.0, 9.81),
            Frame.IOS: (0.0, 0.0, -9.81),
            Frame.FRD: (0.0, 0.0, -9.81),
            Frame.FLU: (0.0, 0.0, 9.81),
        }
        left_turn = {
            Frame.ANDROID: (0.0, 0.0, 1.0),
            Frame.IOS: (0.0, 0.0, 1.0),
            Frame.FRD: (0.0, 0.0, -1.0),
            Frame.FLU: (0.0, 0.0, 1.0),
        }
        for frame in Frame:
            turned = to_android(np.array(field[frame])[:, None], frame)
            np.testing.assert_array_equal(turned, [field[Frame.ANDROID]])
            turned = to_android(np.array(at_rest[frame])[:, None], frame, specific_force=True)
            np.testing.assert_array_equal(turned, [at_rest[Frame.ANDROID]])
            turned = to_android(np.array(left_turn[frame])[:, None], frame)
            np.testing.assert_array_equal(turned, [left_turn[Frame.ANDROID]])

    @given(columns=vectors)
    def test_zero_has_one_sign(self, columns: Float64Array) -> None:
        for frame in Frame:
            assert not np.signbit(to_android(np.zeros_like(columns), frame)).any()

    def test_frames_of_the_same_walk_have_the_same_hash(self) -> None:
        chunk = samples(100)
        body = {"seq": 0, "samples": columns(chunk)}
        expected = from_json(body).content_hash
        frd = columns(chunk)
        for name in ("mag", "acc", "gyro"):
            x, y, z = (frd[name][axis] for axis in "xyz")
            frd[name] = {"x": y, "y": x, "z": -z}
        assert from_json({"seq": 0, "frame": "frd", "samples": frd}).content_hash == expected
        ios = columns(chunk)
        ios["acc"] = {axis: -column for axis, column in ios["acc"].items()}
        assert from_json({"seq": 0, "frame": "ios", "samples": ios}).content_hash == expected
