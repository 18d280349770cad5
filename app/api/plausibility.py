"""Checks of uploaded samples: shape, order, gaps, size, units, limits. Each finding names field and remedy.

Every check looks at whole columns. Stages follow one another because a later one would only repeat an earlier
finding: lengths, finite values, time, units, limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from app.api.errors import RejectedError
from app.api.schemas.samples import SamplesIn, VectorIn
from app.api.validation import FieldError
from app.engine.types import Float64Array

MAX_GAP_S = 1.0
MIN_RATE_HZ = 8.0
"""Steps are 1 to 2.5 a second; recordings of 10 Hz, as slow as some data sets are, still show them."""
MAX_AHEAD_S = 86_400.0
SILENT_S = 2.0
"""A gyroscope that reads exactly 0 for so long is not there."""


@dataclass(frozen=True, slots=True)
class UploadLimits:
    """How much one upload may hold."""

    what: str
    max_samples: int
    max_duration_s: float


SEGMENT_LIMITS = UploadLimits("segment", 20_000, 60.0)
WALK_LIMITS = UploadLimits("walk", 200_000, 1800.0)


@dataclass(frozen=True, slots=True)
class SensorRule:
    """What a sensor can read: ``limit`` for any sample, and typical magnitudes that betray another unit.

    A median magnitude above ``too_high`` or below ``too_low`` (None: not judged) is a unit error: the phrases say
    which. The thresholds come from 800 recorded phone walks, cut into 5-s pieces: medians of 15-74 uT, 5.6-10.8
    m/s^2 and 0.02-2.5 rad/s (in deg/s: 2-145, 99 % above 2.7).
    """

    unit: str
    limit: float
    too_high: float | None
    high_phrase: tuple[str, str]
    too_low: float | None
    low_phrase: tuple[str, str]


SENSORS: Mapping[str, SensorRule] = {
    "mag": SensorRule(
        "uT",
        2000.0,
        2000.0,
        ("looks like nT sent as uT", "divide by 1000: the field is taken in microtesla"),
        1.0,
        ("looks like gauss, mT or T sent as uT", "convert to microtesla (1 G = 100 uT, 1 mT = 1000 uT)"),
    ),
    "acc": SensorRule(
        "m/s^2",
        200.0,
        200.0,
        ("looks like mg sent as m/s^2", "multiply by 0.00980665"),
        3.0,
        (
            "looks like g sent as m/s^2, or gravity was taken out",
            "multiply g by 9.80665; send the accelerometer with gravity, not linear acceleration",
        ),
    ),
    "gyro": SensorRule(
        "rad/s",
        50.0,
        7.0,
        ("looks like deg/s sent as rad/s", "multiply by pi / 180"),
        None,
        ("", ""),
    ),
}

_EARLIEST_MS = datetime(2000, 1, 1, tzinfo=UTC).timestamp() * 1000
_EARLIEST_S, _LATEST_S = 1e8, 1e10
_MICROSECONDS = 1e14
_OTHER_UNITS = (
    (1e3, "seconds", "multiply by 1000"),
    (1e-3, "us", "send Unix milliseconds: divide by 1000"),
    (1e-6, "ns", "send Unix milliseconds: divide by 1000000"),
)


def check_samples(samples: SamplesIn, limits: UploadLimits, now: datetime) -> None:
    """Raise RejectedError with all findings of the first stage that has any; ``now`` is the server's clock."""
    for stage in (_lengths, _finite):
        raise_any(stage(samples))
    raise_any(_size(samples.t_ms, limits))
    raise_any(_time(samples.t_ms, limits, now))
    raise_any(_silent(samples))
    raise_any(finding for name in SENSORS for finding in _sensor(name, getattr(samples, name)))


def raise_any(findings: Iterator[FieldError]) -> None:
    """Raise RejectedError if there are findings."""
    found = list(findings)
    if found:
        raise RejectedError(found)


def _named_columns(samples: SamplesIn) -> Iterator[tuple[str, Float64Array]]:
    yield "samples.t_ms", samples.t_ms
    for name in SENSORS:
        vector: VectorIn = getattr(samples, name)
        yield f"samples.{name}.x", vector.x
        yield f"samples.{name}.y", vector.y
        yield f"samples.{name}.z", vector.z


def _lengths(samples: SamplesIn) -> Iterator[FieldError]:
    n = len(samples.t_ms)
    for name, column in _named_columns(samples):
        if not len(column):
            yield FieldError(name, "is empty", "send at least one value; all columns have the same length")
        elif n and len(column) != n:
            yield length_error(name, len(column), "samples.t_ms", n)


def length_error(name: str, n: int, reference: str, expected: int) -> FieldError:
    """Say that a column has another length than its reference."""
    return FieldError(name, f"has {n} values, {reference} has {expected}", "send one value a row in every column")


def _finite(samples: SamplesIn) -> Iterator[FieldError]:
    for name, column in _named_columns(samples):
        yield from column_finite(name, column)


def column_finite(name: str, column: Float64Array) -> Iterator[FieldError]:
    """Find the first NaN or infinity."""
    finite = np.isfinite(column)
    if not finite.all():
        i = int(finite.argmin())
        word = "NaN" if np.isnan(column[i]) else "infinite"
        yield FieldError(name, f"value {i} is {word}", "send finite numbers; leave samples without a reading out")


def _size(t_ms: Float64Array, limits: UploadLimits) -> Iterator[FieldError]:
    if len(t_ms) > limits.max_samples:
        yield FieldError(
            "samples.t_ms",
            f"has {len(t_ms)} samples",
            f"send at most {limits.max_samples} a {limits.what}; split longer recordings",
        )


def _time(t_ms: Float64Array, limits: UploadLimits, now: datetime) -> Iterator[FieldError]:
    wrong_unit = _time_unit(t_ms) or _absurd_time(t_ms, now)
    if wrong_unit is not None:
        yield wrong_unit
        return
    order = list(not_increasing("samples.t_ms", t_ms))
    yield from order
    if order:
        return
    steps = np.diff(t_ms)
    gaps = steps > MAX_GAP_S * 1000
    if gaps.any():
        i = int(gaps.argmax())
        yield FieldError(
            "samples.t_ms",
            f"has a gap of {steps[i] / 1000:.2f} s after value {i}",
            f"split the upload there; inside one {limits.what} at most {MAX_GAP_S:g} s may be missing",
        )
    duration_s = (t_ms[-1] - t_ms[0]) / 1000
    if duration_s > limits.max_duration_s:
        yield FieldError(
            "samples.t_ms",
            f"spans {duration_s:.1f} s",
            f"send at most {limits.max_duration_s:g} s a {limits.what}; split longer recordings",
        )
    if len(steps) and np.median(steps) > 1000 / MIN_RATE_HZ:
        yield FieldError(
            "samples.t_ms",
            f"has a median interval of {np.median(steps):.0f} ms",
            f"send at least {MIN_RATE_HZ:g} samples a second; 50 to 100 are good",
        )


def _time_unit(t_ms: Float64Array) -> FieldError | None:
    first = t_ms[0]
    if first >= _MICROSECONDS:
        return FieldError("samples.t_ms", f"starts at {first:.0f}: looks like us or ns", "send Unix milliseconds")
    # Seconds since 1970 tick in steps far below one; milliseconds of the same size (March 1970) would not.
    if _EARLIEST_S <= first < _LATEST_S and len(t_ms) > 1 and 0 < (t_ms[-1] - first) / (len(t_ms) - 1) < 0.5:
        return FieldError("samples.t_ms", f"starts at {first:.3f}: looks like seconds", "multiply by 1000")
    return None


def _absurd_time(t_ms: Float64Array, now: datetime) -> FieldError | None:
    first, last = float(t_ms.min()), float(t_ms.max())
    if first < _EARLIEST_MS:
        return FieldError(
            "samples.t_ms",
            f"starts at {first:.15g}, before the year 2000",
            "send Unix milliseconds: add the time at which the recording's own clock began",
        )
    if last > (now.timestamp() + MAX_AHEAD_S) * 1000:
        ahead = f"ends at {last:.15g}, more than a day ahead of the server's clock ({now:%Y-%m-%d %H:%M} UTC)"
        return FieldError("samples.t_ms", ahead, "send Unix milliseconds, and set the device's clock")
    return None


def _silent(samples: SamplesIn) -> Iterator[FieldError]:
    if not _reads(samples.mag):
        yield FieldError("samples.mag", "has no reading: every value is 0", "send the magnetometer's readings in uT")
    span_s = (samples.t_ms[-1] - samples.t_ms[0]) / 1000
    if span_s >= SILENT_S and not _reads(samples.gyro):
        yield FieldError(
            "samples.gyro",
            f"has no reading: every value of {span_s:.1f} s is 0",
            "send the gyroscope's readings in rad/s; without one a device cannot be located",
        )


def _reads(vector: VectorIn) -> bool:
    return bool(vector.x.any() or vector.y.any() or vector.z.any())


def not_increasing(name: str, t_ms: Float64Array) -> Iterator[FieldError]:
    """Find the first time that does not go on."""
    backwards = np.diff(t_ms) <= 0
    if backwards.any():
        i = int(backwards.argmax())
        word = "repeats" if t_ms[i + 1] == t_ms[i] else "runs backwards"
        yield FieldError(
            name,
            f"time {word} at value {i + 1} ({t_ms[i + 1]:.3f} after {t_ms[i]:.3f})",
            "send each sample once, in time order",
        )


def outside_time(
    name: str, noun: str, times_ms: Float64Array, t_ms: Float64Array, slack_s: float, remedy: str
) -> Iterator[FieldError]:
    """Find the first of other times that lies more than ``slack_s`` outside those of the samples."""
    slack = slack_s * 1000
    low, high = t_ms[0] - slack, t_ms[-1] + slack
    outside = (times_ms < low) | (times_ms > high)
    if not outside.any():
        return
    i = int(outside.argmax())
    # The samples are in milliseconds: the right unit is the one that brings all others there.
    for factor, unit, conversion in _OTHER_UNITS:
        if low <= times_ms.min() * factor and times_ms.max() * factor <= high:
            yield FieldError(name, f"starts at {times_ms[0]:.15g}: looks like {unit}", conversion)
            return
    yield FieldError(
        name,
        f"{noun} {i} ({times_ms[i]:.0f}) is more than {slack_s:g} s outside the samples' time "
        f"({t_ms[0]:.0f} to {t_ms[-1]:.0f})",
        remedy,
    )


def _sensor(name: str, vector: VectorIn) -> Iterator[FieldError]:
    rule = SENSORS[name]
    magnitude = np.sqrt(vector.x**2 + vector.y**2 + vector.z**2)
    field = f"samples.{name}"
    wrong_unit = _sensor_unit(field, magnitude, rule)
    if wrong_unit is not None:
        yield wrong_unit
        return
    i = int(magnitude.argmax())
    if magnitude[i] > rule.limit:
        yield FieldError(
            field,
            f"sample {i} has {magnitude[i]:.4g} {rule.unit}",
            f"no sample may exceed {rule.limit:g} {rule.unit}; check the unit, or leave disturbed samples out",
        )


def _sensor_unit(field: str, magnitude: Float64Array, rule: SensorRule) -> FieldError | None:
    # "More than half of the samples" is the median without sorting.
    half = len(magnitude) / 2
    if rule.too_high is not None and np.count_nonzero(magnitude > rule.too_high) > half:
        what, remedy = rule.high_phrase
    elif rule.too_low is not None and np.count_nonzero(magnitude < rule.too_low) > half:
        what, remedy = rule.low_phrase
    else:
        return None
    return FieldError(field, f"median magnitude {np.median(magnitude):.4g} {rule.unit}: {what}", remedy)
