"""Readings of a phone on one time base: what is complete, however it was cut."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.types import Float64Array, ImuSamples
from app.exchange.phones import (
    Annotation,
    Assembled,
    FormatError,
    PhoneFrame,
    Readings,
    Sensor,
    Series,
    assemble,
    missing,
)
from app.exchange.phones.assembly import HOLD_NS, MAX_LAG_NS
from app.exchange.phones.readings import MAX_TIME_NS

S = 1_000_000_000
T0 = 1_698_501_144_401_773_000
MS = 1_000_000


def curve(t_ns: np.ndarray, sensor: Sensor) -> Float64Array:
    """Values that tell their time and sensor: smooth, so that interpolation can be checked."""
    phase = (t_ns - T0)[:, None] / S * (1.0 + 0.1 * np.arange(sensor.width)) + list(Sensor).index(sensor)
    return 10.0 * np.sin(phase)


def series(sensor: Sensor, t_ns: Sequence[int] | np.ndarray) -> Series:
    times = np.asarray(t_ns, np.int64)
    return Series.ordered(times, curve(times, sensor))


def even(rate_hz: float, seconds: float, *, start_s: float = 0.0) -> np.ndarray:
    return T0 + np.round((start_s + np.arange(0.0, seconds, 1.0 / rate_hz)) * S).astype(np.int64)


def recording(mag_hz: float = 50.0, seconds: float = 4.0, **others: float) -> Readings:
    """Sensors at different rates, each begun at another moment."""
    return Readings(
        {
            Sensor.MAGNETOMETER: series(Sensor.MAGNETOMETER, even(mag_hz, seconds)),
            Sensor.ACCELERATION: series(Sensor.ACCELERATION, even(100.0, seconds, start_s=0.003)),
            Sensor.GYROSCOPE: series(Sensor.GYROSCOPE, even(80.0, seconds, start_s=0.011)),
        }
    )


def without(readings: Readings, sensor: Sensor, low_s: float, high_s: float) -> Readings:
    one = readings.series[sensor]
    silent = (one.t_ns > T0 + low_s * S) & (one.t_ns < T0 + high_s * S)
    return Readings({**readings.series, sensor: one.where(~silent)}, readings.annotations)


def samples_of(*parts: Assembled) -> ImuSamples:
    found = [part.samples for part in parts if part.samples is not None]
    return ImuSamples(*(np.concatenate([getattr(one, name) for one in found]) for name in ("t", "mag", "acc", "gyro")))


def stream(pieces: Sequence[Readings], frame: PhoneFrame = PhoneFrame.ANDROID) -> list[Assembled]:
    """Pieces one after the other, the rest packed in between as a service keeps it."""
    parts: list[Assembled] = []
    rest, after = Readings(), None
    for number, piece in enumerate(pieces, start=1):
        final = number == len(pieces)
        part = assemble(Readings.merged([rest, piece]), frame, after_ns=after, final=final)
        rest, after = Readings.unpack(part.rest.pack()), part.until_ns
        parts.append(part)
    return parts


def test_all_sensors_meet_at_the_magnetometers_times() -> None:
    readings = recording()
    part = assemble(readings, PhoneFrame.ANDROID)
    assert part.samples is not None
    last = min(int(one.t_ns[-1]) for one in readings.series.values())
    assert part.until_ns == last
    own = readings.series[Sensor.MAGNETOMETER].t_ns
    expected = own[(own >= T0 + 11 * MS) & (own <= last)]
    assert np.round((part.samples.t - T0 / S) * 1e6) == pytest.approx((expected - T0) / 1000, abs=1.0)
    assert np.array_equal(part.samples.mag, curve(expected, Sensor.MAGNETOMETER))
    for name, sensor in (("acc", Sensor.ACCELERATION), ("gyro", Sensor.GYROSCOPE)):
        assert getattr(part.samples, name) == pytest.approx(curve(expected, sensor), abs=1e-2), name


def test_specific_force_is_the_sum_where_the_phone_parts_it() -> None:
    readings = recording()
    series_ = {sensor: one for sensor, one in readings.series.items() if sensor is not Sensor.ACCELERATION}
    series_[Sensor.LINEAR_ACCELERATION] = series(Sensor.LINEAR_ACCELERATION, even(100.0, 4.0, start_s=0.003))
    series_[Sensor.GRAVITY] = series(Sensor.GRAVITY, even(60.0, 4.0, start_s=0.005))
    part = samples_of(assemble(Readings(series_), PhoneFrame.ANDROID, final=True))
    t_ns = np.round(part.t * 1e6).astype(np.int64) * 1000
    total = curve(t_ns, Sensor.LINEAR_ACCELERATION) + curve(t_ns, Sensor.GRAVITY)
    assert part.acc == pytest.approx(total, abs=2e-2)


def test_apples_signs_are_turned() -> None:
    android, ios, told = (samples_of(assemble(recording(), frame)) for frame in PhoneFrame)
    assert np.array_equal(ios.acc, -android.acc)
    for name in ("mag", "gyro"):
        assert np.array_equal(getattr(ios, name), getattr(android, name))
    assert np.array_equal(told.acc, android.acc)


def test_a_slow_magnetometer_is_told_at_the_accelerometers_times() -> None:
    readings = recording(mag_hz=12.0)
    part = samples_of(assemble(readings, PhoneFrame.ANDROID))
    assert np.median(np.diff(part.t)) == pytest.approx(0.01, abs=1e-5)
    t_ns = np.round(part.t * 1e6).astype(np.int64) * 1000
    assert part.mag == pytest.approx(curve(t_ns, Sensor.MAGNETOMETER), abs=2e-2)
    assert np.isin(t_ns[1:], readings.series[Sensor.ACCELERATION].t_ns).all()


@pytest.mark.parametrize("sensor", [Sensor.MAGNETOMETER, Sensor.ACCELERATION, Sensor.GYROSCOPE])
def test_a_silence_is_not_bridged(sensor: Sensor) -> None:
    part = samples_of(assemble(without(recording(), sensor, 1.0, 1.8), PhoneFrame.ANDROID, final=True))
    inside = (part.t > T0 / S + 1.02) & (part.t < T0 / S + 1.78)
    assert not inside.any()
    short = samples_of(assemble(without(recording(), sensor, 1.0, 1.4), PhoneFrame.ANDROID, final=True))
    assert np.diff(short.t).max() < 0.03  # the accelerometer's times, where it is the magnetometer that is silent


def test_the_calibrated_magnetometer_is_preferred() -> None:
    readings = recording()
    raw = {Sensor.MAGNETOMETER_UNCALIBRATED: series(Sensor.MAGNETOMETER_UNCALIBRATED, even(50.0, 4.0))}
    both = assemble(Readings({**readings.series, **raw}), PhoneFrame.ANDROID)
    assert np.array_equal(samples_of(both).mag, samples_of(assemble(readings, PhoneFrame.ANDROID)).mag)
    only = {sensor: one for sensor, one in readings.series.items() if sensor is not Sensor.MAGNETOMETER}
    part = samples_of(assemble(Readings({**only, **raw}), PhoneFrame.ANDROID))
    t_ns = np.round(part.t * 1e6).astype(np.int64) * 1000
    assert np.array_equal(part.mag, curve(t_ns, Sensor.MAGNETOMETER_UNCALIBRATED))


def test_what_is_missing_is_told() -> None:
    assert missing(recording()) == ()
    assert missing(Readings()) == ("magnetometer", "gyroscope", "accelerometer", "gravity")
    parted = Readings({Sensor.LINEAR_ACCELERATION: series(Sensor.LINEAR_ACCELERATION, even(50.0, 1.0))})
    assert missing(parted) == ("magnetometer", "gyroscope", "gravity")
    part = assemble(parted, PhoneFrame.ANDROID)
    assert (part.samples, part.until_ns) == (None, None)
    assert len(part.rest) == 50


def test_a_sensor_that_fell_silent_is_not_waited_for_for_ever() -> None:
    """What waits in the rest stays small."""
    readings = without(recording(seconds=60.0), Sensor.GYROSCOPE, 5.0, 100.0)
    pieces = [
        Readings({k: one.where((one.t_ns >= low) & (one.t_ns < low + S)) for k, one in readings.series.items()})
        for low in range(T0, T0 + 60 * S, S)
    ]
    parts = stream(pieces)
    assert samples_of(*parts).t[-1] == pytest.approx(T0 / S + 5.0, abs=0.03)
    assert max(len(part.rest) for part in parts) < 160 * (MAX_LAG_NS / S + 2)


def test_a_message_that_was_overtaken_still_counts() -> None:
    readings = recording(seconds=6.0)
    pieces = [
        Readings({k: one.where((one.t_ns >= low) & (one.t_ns < low + S)) for k, one in readings.series.items()})
        for low in range(T0, T0 + 6 * S, S)
    ]
    pieces[2], pieces[3] = pieces[3], pieces[2]
    assert HOLD_NS > S
    whole = samples_of(assemble(readings, PhoneFrame.ANDROID, final=True))
    assert np.array_equal(samples_of(*stream(pieces)).acc, whole.acc)


def test_aids_and_annotations_go_along_once() -> None:
    readings = recording(seconds=6.0)
    aids = {
        Sensor.PRESSURE: series(Sensor.PRESSURE, even(10.0, 6.0)),
        Sensor.GNSS: series(Sensor.GNSS, even(1.0, 6.0)),
        Sensor.STEPS: Series(even(2.0, 6.0), np.arange(12.0)[:, None]),
    }
    notes = tuple(Annotation(T0 + k * S, f"{k},0") for k in range(8))
    whole = Readings({**readings.series, **aids}, notes)
    pieces = [
        Readings(
            {k: one.where((one.t_ns >= low) & (one.t_ns < low + S)) for k, one in whole.series.items()},
            tuple(note for note in notes if low <= note.t_ns < low + S),
        )
        for low in range(T0, T0 + 8 * S, S)
    ]
    parts = stream(pieces)
    assert [note for part in parts for note in part.annotations] == list(notes)
    for name, sensor in (("pressure", Sensor.PRESSURE), ("gnss", Sensor.GNSS), ("steps", Sensor.STEPS)):
        t = np.concatenate([getattr(part, name).t for part in parts if getattr(part, name) is not None])
        assert t == pytest.approx(aids[sensor].t_ns / S, abs=1e-6), name


def test_a_late_aid_is_told_and_an_old_one_is_not() -> None:
    readings = recording(seconds=30.0)
    for behind, told in ((2.0, True), (20.0, False)):
        after = T0 + 25 * S
        late = Readings({Sensor.STEPS: Series(np.array([after - int(behind * S)]), np.array([[7.0]]))})
        part = assemble(Readings.merged([readings, late]), PhoneFrame.ANDROID, after_ns=after)
        assert (part.steps is not None) == told


def test_a_counter_that_falls_is_not_believed() -> None:
    counts = Series(even(2.0, 4.0), np.array([3.0, 4, 5, 1, 2, 6, 7, 8])[:, None])
    part = assemble(Readings({**recording().series, Sensor.STEPS: counts}), PhoneFrame.ANDROID, final=True)
    assert part.steps is not None
    assert part.steps.count.tolist() == [3.0, 4.0, 5.0, 6.0, 7.0, 8.0]


@st.composite
def recordings(draw: Callable[..., object]) -> Readings:
    """Sensors with uneven times, silences, and rates on both sides of 20 Hz."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))  # type: ignore[call-overload]
    sensors = [Sensor.MAGNETOMETER, Sensor.GYROSCOPE, Sensor.PRESSURE]
    sensors += [Sensor.ACCELERATION] if draw(st.booleans()) else [Sensor.LINEAR_ACCELERATION, Sensor.GRAVITY]
    found = {}
    for sensor in sensors:
        step_s = 1.0 / draw(st.sampled_from([8.0, 18.0, 20.0, 25.0, 60.0]))  # type: ignore[operator]
        steps = step_s * rng.uniform(0.2, 1.8, int(6.0 / step_s))
        steps[rng.random(len(steps)) < 0.02] += 0.7
        steps[0] = rng.uniform(0.0, 0.1)
        found[sensor] = series(sensor, T0 + np.cumsum(np.round(steps * S).astype(np.int64)))
    return Readings(found)


@settings(max_examples=150, deadline=None)
@given(recordings(), st.data())
def test_however_it_is_cut_the_samples_are_those_of_the_whole(readings: Readings, data: st.DataObject) -> None:
    """Sensors may be cut at different moments, and lag behind one another by less than two seconds."""
    whole = assemble(readings, PhoneFrame.IOS, final=True)
    cuts = sorted(data.draw(st.lists(st.integers(1, 6000), max_size=8), label="cuts"))
    lags = {sensor: data.draw(st.integers(0, 2000), label=sensor) for sensor in readings.series}
    pieces = []
    for low, high in itertools.pairwise([-1, *cuts, 100_000]):
        part = {}
        for sensor, one in readings.series.items():
            lag = lags[sensor] if high < 100_000 else 0  # the last piece holds all that is left
            # the first reading of each sensor comes with the first piece: before, nobody knows that it will tell
            first = int(one.t_ns[0])
            start = -1 if low < 0 else max(first, T0 + (low - lags[sensor]) * MS)
            stop = max(first, T0 + (high - lag) * MS)
            part[sensor] = one.where((one.t_ns > start) & (one.t_ns <= stop))
        pieces.append(Readings(part))
    parts = stream(pieces, PhoneFrame.IOS)
    if whole.samples is None:
        assert all(part.samples is None for part in parts)
        return
    found = samples_of(*parts)
    for name in ("t", "mag", "acc", "gyro"):
        assert np.array_equal(getattr(found, name), getattr(whole.samples, name)), name
    assert (np.diff(found.t) > 0).all()


def test_order_and_repetition_do_not_matter() -> None:
    readings = recording()
    pieces = [
        Readings({k: one.where((one.t_ns >= low) & (one.t_ns < low + S)) for k, one in readings.series.items()})
        for low in range(T0, T0 + 4 * S, S)
    ]
    mixed = Readings.merged([pieces[2], pieces[0], pieces[3], pieces[2], pieces[1]])
    for sensor, one in readings.series.items():
        assert np.array_equal(mixed.series[sensor].t_ns, one.t_ns)
        assert np.array_equal(mixed.series[sensor].values, one.values)
    later = mixed.after(T0 + S)
    assert all((one.t_ns > T0 + S).all() for one in later.series.values())


def test_packing_keeps_everything() -> None:
    readings = Readings(recording().series, (Annotation(T0, "Tür 3"), Annotation(T0 + 5, "2,4")))
    again = Readings.unpack(readings.pack())
    assert again.annotations == readings.annotations
    for sensor, one in readings.series.items():
        assert np.array_equal(again.series[sensor].t_ns, one.t_ns)
        assert np.array_equal(again.series[sensor].values, one.values)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_damaged_packs_are_refused(data: st.DataObject) -> None:
    content = bytearray(recording(seconds=0.2).pack())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        found = Readings.unpack(bytes(content[: data.draw(st.integers(0, len(content)))]))
    except FormatError:
        return
    assert all((np.diff(one.t_ns) > 0).all() and np.isfinite(one.values).all() for one in found.series.values())
    assert all(one.t_ns[-1] <= MAX_TIME_NS for one in found.series.values())
