"""Readings of many clocks brought to one time base, as far as all sensors have told.

Every sample depends on the readings next to it and on nothing else, so that a recording cut into pieces, in whichever
way, gives the samples of the whole: to the bit. For this reason the time base is chosen between each two readings of
the magnetometer, and times are kept to the microsecond.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from app.engine.types import BoolArray, Float64Array, ImuSamples, IntArray, PressureReadings, StepCounts
from app.exchange.phones.readings import MAX_TIME_NS, NS, Annotation, Readings, Sensor, Series

SLOW_NS = NS // 20
"""Magnetometer readings further apart than this (20 Hz) are joined by the accelerometer's times: steps need them."""
MAX_GAP_NS = NS // 2
"""Of no sensor a longer silence is bridged."""
MAX_LAG_NS = 10 * NS
"""A sensor that is behind two others by more is not waited for."""
HOLD_NS = 3 * NS
"""So long a silence is kept open, for messages overtake each other: what is missing may be under way."""
LATE_NS = 10 * NS
"""Readings of satellites, pressure and steps older than what was assembled by more are no longer told."""
_TICK_NS = 1000
_MAGNETOMETERS = (Sensor.MAGNETOMETER, Sensor.MAGNETOMETER_UNCALIBRATED)
_TURNED = (Sensor.ACCELERATION, Sensor.LINEAR_ACCELERATION, Sensor.GRAVITY)
"""Sensors that Apple reads with the opposite sign."""
_AIDS = (Sensor.GNSS, Sensor.PRESSURE, Sensor.STEPS)


class PhoneFrame(StrEnum):
    """Axes and signs of a phone's readings: Android's, Apple's, or Apple's told as Android's.

    Apple's accelerometer and gravity have the opposite sign on all axes (a phone lying face up reads gravity as
    -9.81 on z); its magnetometer and gyroscope read as Android's.
    """

    ANDROID = "android"
    IOS = "ios"
    STANDARDISED = "standardised"


@dataclass(frozen=True, slots=True)
class GnssColumns:
    """Satellite fixes: ``t`` (m,) UTC s, WGS 84 (m,) degrees, ``accuracy_m`` (m,) 68 % radius."""

    t: Float64Array
    latitude_deg: Float64Array
    longitude_deg: Float64Array
    accuracy_m: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class Assembled:
    """What is complete.

    Attributes
    ----------
    samples : ImuSamples or None
        In Android's body frame; None where nothing is complete yet. May have gaps.
    gnss, pressure, steps : columns or None
        Up to ``until_ns``, and what came late.
    annotations : tuple of Annotation
    until_ns : int or None
        The watermark: what is ``after_ns`` in the next call. None where no sensor has told anything yet.
    rest : Readings
        What the next call needs beside new readings.
    """

    samples: ImuSamples | None = None
    gnss: GnssColumns | None = None
    pressure: PressureReadings | None = None
    steps: StepCounts | None = None
    annotations: tuple[Annotation, ...] = ()
    until_ns: int | None = None
    rest: Readings = field(default_factory=Readings)


def assemble(readings: Readings, frame: PhoneFrame, *, after_ns: int | None = None, final: bool = False) -> Assembled:
    """Cut off what is complete.

    Parameters
    ----------
    readings : Readings
        What is new, merged with the ``rest`` of the call before.
    frame : PhoneFrame
    after_ns : int or None, ns
        Up to where samples were taken already: ``until_ns`` of the call before.
    final : bool
        Nothing will follow: take all that can be had.

    Returns
    -------
    Assembled
        Specific force is linear acceleration plus gravity where the phone tells no acceleration with gravity; the
        calibrated magnetometer is preferred, the uncalibrated taken if it is the only one.
    """
    ticks = {sensor: _ticked(series) for sensor, series in readings.series.items() if len(series)}
    needed = _needed(ticks)
    until = _watermark(ticks, needed, after_ns, final=final)
    if until is None:
        notes = readings.annotations
        taken, kept = (notes, ()) if final else ((), notes)
        return Assembled(annotations=taken, until_ns=after_ns, rest=Readings(ticks, kept))
    floor = after_ns if after_ns is not None else min(int(one.t_ns[0]) for one in ticks.values()) - 1
    samples = None if needed is None else _samples(ticks, needed, frame, floor, until)
    aids = {sensor: _told(ticks.get(sensor), floor - LATE_NS, until) for sensor in _AIDS}
    noted = MAX_TIME_NS if final else until
    return Assembled(
        samples=samples,
        gnss=_gnss(aids[Sensor.GNSS]),
        pressure=_pressure(aids[Sensor.PRESSURE]),
        steps=_steps(aids[Sensor.STEPS]),
        annotations=tuple(note for note in readings.annotations if note.t_ns <= noted),
        until_ns=until,
        rest=_rest(ticks, tuple(note for note in readings.annotations if note.t_ns > noted), until),
    )


@dataclass(frozen=True, slots=True)
class _Needed:
    """The sensors of which a sample is made; ``acc`` are added up, and the first of them gives times."""

    mag: Sensor
    gyro: Sensor
    acc: tuple[Sensor, ...]

    @property
    def all(self) -> tuple[Sensor, ...]:
        return (self.mag, self.gyro, *self.acc)


def _ticked(series: Series) -> Series:
    """Readings at whole microseconds: as fine as float64 seconds carry, so that times stay apart."""
    return Series.ordered(series.t_ns // _TICK_NS * _TICK_NS, series.values)


def _needed(ticks: Mapping[Sensor, Series]) -> _Needed | None:
    """The sensors to take; None if some are not there."""
    mag = next((one for one in _MAGNETOMETERS if one in ticks), None)
    whole = Sensor.ACCELERATION in ticks
    acc = (Sensor.ACCELERATION,) if whole else (Sensor.LINEAR_ACCELERATION, Sensor.GRAVITY)
    if mag is None or Sensor.GYROSCOPE not in ticks or any(one not in ticks for one in acc):
        return None
    return _Needed(mag, Sensor.GYROSCOPE, acc)


def in_frame(readings: Readings, told: PhoneFrame, wanted: PhoneFrame) -> Readings:
    """Readings with the signs of another frame: what tells its frame is kept in that of all the others."""
    if (told is PhoneFrame.IOS) is (wanted is PhoneFrame.IOS):
        return readings
    turned = {
        sensor: Series(series.t_ns, -series.values) if sensor in _TURNED else series
        for sensor, series in readings.series.items()
    }
    return Readings(turned, readings.annotations)


def missing(readings: Readings) -> tuple[str, ...]:
    """What a phone has to tell besides, in words; empty if samples can be made of what it tells."""
    told = {sensor for sensor, series in readings.series.items() if len(series)}
    lacking = [] if told & set(_MAGNETOMETERS) else ["magnetometer"]
    lacking += [] if Sensor.GYROSCOPE in told else ["gyroscope"]
    if Sensor.ACCELERATION not in told:
        lacking += [] if Sensor.LINEAR_ACCELERATION in told else ["accelerometer"]
        lacking += [] if Sensor.GRAVITY in told else ["gravity"]
    return tuple(lacking)


def _watermark(
    ticks: Mapping[Sensor, Series], needed: _Needed | None, after_ns: int | None, *, final: bool
) -> int | None:
    """Up to where nothing more is expected of any sensor; None: wait."""
    lasts = sorted(int(one.t_ns[-1]) for one in ticks.values())
    if not lasts:
        return None
    if final:
        return max(lasts[-1], lasts[-1] if after_ns is None else after_ns)
    # two sensors must be ahead: a single clock that jumps does not leave the others behind
    inertial = sorted(int(one.t_ns[-1]) for sensor, one in ticks.items() if sensor not in _AIDS) or lasts
    reached = inertial[-2 if len(inertial) > 1 else -1]
    known = min(int(one.t_ns[0]) for one in ticks.values()) if after_ns is None else after_ns
    until = reached - MAX_LAG_NS
    if needed is not None:
        complete = min(int(ticks[sensor].t_ns[-1]) for sensor in needed.all)
        silences = [_open_silence(ticks[sensor].t_ns, known, reached) for sensor in needed.all]
        until = max(until, min(complete, *silences))
    if until >= known:
        return until
    return after_ns


def _open_silence(t_ns: IntArray, known_ns: int, reached_ns: int) -> int:
    """Beginning of the first silence of a sensor that may yet be filled; the end of all times if there is none."""
    end = t_ns[1:]
    still_open = (np.diff(t_ns) > MAX_GAP_NS) & (end > known_ns) & (end > reached_ns - HOLD_NS)
    return int(t_ns[int(still_open.argmax())]) if still_open.any() else MAX_TIME_NS


def _samples(
    ticks: Mapping[Sensor, Series], needed: _Needed, frame: PhoneFrame, after_ns: int, until_ns: int
) -> ImuSamples | None:
    t_ns = _base(ticks[needed.mag].t_ns, ticks[needed.acc[0]].t_ns)
    t_ns = t_ns[(t_ns > after_ns) & (t_ns <= until_ns)]
    inside = np.ones(len(t_ns), dtype=bool)
    for sensor in needed.all:
        inside &= _covered(t_ns, ticks[sensor].t_ns)
    t_ns = t_ns[inside]
    if not len(t_ns):
        return None
    force = np.sum([_at(t_ns, ticks[sensor]) for sensor in needed.acc], axis=0)
    sign = -1.0 if frame is PhoneFrame.IOS else 1.0
    return ImuSamples(
        t=_seconds(t_ns),
        mag=_at(t_ns, ticks[needed.mag]),
        # + 0.0 turns -0.0 into 0.0, so that equal readings have equal bytes
        acc=sign * force + 0.0,
        gyro=_at(t_ns, ticks[needed.gyro]),
    )


def _base(mag_ns: IntArray, acc_ns: IntArray) -> IntArray:
    """Times of samples: the magnetometer's, and the accelerometer's between two that are further apart than 20 Hz.

    A reading behind such an interval is left out, for the accelerometer's times need not meet it; behind a silence
    that is not bridged it begins anew.
    """
    interval = np.diff(mag_ns)
    slow = (interval > SLOW_NS) & (interval <= MAX_GAP_NS)
    own = np.ones(len(mag_ns), dtype=bool)
    own[1:] = ~slow
    behind = np.searchsorted(mag_ns, acc_ns)  # acc lies in (mag[behind - 1], mag[behind]]
    known = (behind > 0) & (behind < len(mag_ns))
    between = np.zeros(len(acc_ns), dtype=bool)
    between[known] = slow[behind[known] - 1]
    return np.union1d(mag_ns[own], acc_ns[between])


def _covered(t_ns: IntArray, other_ns: IntArray) -> BoolArray:
    """Where a sensor reads at the very moment, or before and after without a longer silence."""
    after = np.searchsorted(other_ns, t_ns)
    at = np.clip(after, 1, max(1, len(other_ns) - 1))
    hit: BoolArray = other_ns[np.minimum(after, len(other_ns) - 1)] == t_ns
    if len(other_ns) < 2:
        return hit
    bridged = (after > 0) & (after < len(other_ns)) & (other_ns[at] - other_ns[at - 1] <= MAX_GAP_NS)
    covered: BoolArray = hit | bridged
    return covered


def _at(t_ns: IntArray, series: Series) -> Float64Array:
    """Readings at times that are covered, linearly between the two next to each.

    The weight is a quotient of small integers: the same wherever the recording was cut.
    """
    after = np.clip(np.searchsorted(series.t_ns, t_ns), 0, len(series) - 1)
    before = np.where(series.t_ns[after] == t_ns, after, np.maximum(after - 1, 0))
    step = np.maximum(series.t_ns[after] - series.t_ns[before], 1)
    weight = ((t_ns - series.t_ns[before]) / step)[:, None]
    values: Float64Array = series.values[before] + weight * (series.values[after] - series.values[before])
    return values


def _seconds(t_ns: IntArray) -> Float64Array:
    return (t_ns // _TICK_NS) / 1e6


def _told(series: Series | None, after_ns: int, until_ns: int) -> Series | None:
    if series is None:
        return None
    rows = series.where((series.t_ns > after_ns) & (series.t_ns <= until_ns))
    return rows if len(rows) else None


def _gnss(series: Series | None) -> GnssColumns | None:
    if series is None:
        return None
    latitude, longitude, accuracy = np.ascontiguousarray(series.values.T)
    return GnssColumns(_seconds(series.t_ns), latitude, longitude, accuracy)


def _pressure(series: Series | None) -> PressureReadings | None:
    return None if series is None else PressureReadings(_seconds(series.t_ns), series.values[:, 0].copy())


def _steps(series: Series | None) -> StepCounts | None:
    """Counts as told, without those that fall: a counter that begins anew tells nothing until it is past."""
    if series is None:
        return None
    count = series.values[:, 0]
    rising = count >= np.maximum.accumulate(count)
    return StepCounts(_seconds(series.t_ns[rising]), count[rising])


def _rest(ticks: Mapping[Sensor, Series], notes: tuple[Annotation, ...], until_ns: int) -> Readings:
    """What is after the watermark, and the reading of each sensor before it, unless that is long past."""
    kept: dict[Sensor, Series] = {}
    for sensor, series in ticks.items():
        start = int(np.searchsorted(series.t_ns, until_ns, "right"))
        if sensor not in _AIDS and start > 0 and series.t_ns[start - 1] > until_ns - MAX_LAG_NS:
            start -= 1
        if start < len(series):
            kept[sensor] = series.where(slice(start, None))
    return Readings(kept, notes)
