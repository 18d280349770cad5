"""Units of sensors and clocks: named by the file or the sender, else guessed from what sensors can read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from app.engine.errors import InputError
from app.engine.types import Float64Array
from app.exchange.surveys.recording import DEFAULT_START_S, Findings

_G = 9.80665


@dataclass(frozen=True, slots=True)
class Quantity:
    """What a sensor measures.

    ``factors`` take a unit to the engine's; a median magnitude within ``plausible`` (engine's unit) lets a unit be
    guessed. The first unit is the engine's own.
    """

    words: str
    factors: Mapping[str, float]
    plausible: tuple[float, float]


QUANTITIES: Mapping[str, Quantity] = {
    # the earth's field is 22 to 67 uT; steel takes and adds some
    "mag": Quantity(
        "magnetic field", {"ut": 1.0, "nt": 1e-3, "gauss": 100.0, "mt": 1e3, "t": 1e6, "mgauss": 0.1}, (12.0, 200.0)
    ),
    "acc": Quantity("acceleration", {"m/s2": 1.0, "g": _G, "mg": 1e-3 * _G}, (5.0, 16.0)),
    # walkers turn at 0.02 to 2.5 rad/s (median of 5 s); in deg/s these are 1 to 145
    "gyro": Quantity(
        "rotation rate", {"rad/s": 1.0, "deg/s": np.pi / 180.0, "mdeg/s": 1e-3 * np.pi / 180.0}, (0.0, 2.7)
    ),
}
_SPELLINGS: Mapping[str, str] = {
    "microtesla": "ut", "µt": "ut", "μt": "ut", "nanotesla": "nt", "millitesla": "mt", "tesla": "t", "gs": "gauss",
    "mgs": "mgauss", "m/s^2": "m/s2", "m/s²": "m/s2", "m/s/s": "m/s2", "ms2": "m/s2", "ms-2": "m/s2", "m_s2": "m/s2",
    "m_s_2": "m/s2", "rad_s": "rad/s", "rads": "rad/s", "rad/sec": "rad/s", "deg_s": "deg/s", "dps": "deg/s",
    "°/s": "deg/s", "deg/sec": "deg/s", "mdps": "mdeg/s",
}  # fmt: skip
CLOCKS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_STEPS = (0.001, 0.2)
"""s: sample intervals of phones."""
_LATEST_S = 4.1e9
_EARLIEST_S = 9.0e8
"""Years 1998 to 2099 as Unix seconds."""


def unit_of(quantity: str, text: str) -> str | None:
    """A unit as written, in this module's spelling; None if it is none of this quantity."""
    plain = text.strip().lower()
    plain = _SPELLINGS.get(plain, plain)
    return plain if plain in QUANTITIES[quantity].factors else None


def factor_of(quantity: str, values: Float64Array, unit: str | None, findings: Findings) -> float:
    """What takes three columns, shape (n, 3), to the engine's unit.

    Raises
    ------
    InputError
        No unit is given and none fits.
    """
    known = QUANTITIES[quantity]
    if unit is None:
        unit = _guess(quantity, values)
        findings.assume(f"{known.words} as {unit} by its magnitude ({_median(values):.4g})")
    return known.factors[unit]


def _median(values: Float64Array) -> float:
    return float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0


def _guess(quantity: str, values: Float64Array) -> str:
    known = QUANTITIES[quantity]
    median = _median(values)
    low, high = known.plausible
    for unit, factor in known.factors.items():
        if low <= median * factor <= high:
            return unit
    hint = "; send the accelerometer with gravity" if quantity == "acc" else ""
    raise InputError(
        quantity,
        f"has a median magnitude of {median:.4g}, which is no {known.words} in any known unit{hint}; "
        f"name the unit: --unit {quantity}=... (one of {', '.join(known.factors)})",
    )


def to_seconds(t: Float64Array, unit: str | None, start_s: float | None, findings: Findings) -> Float64Array:
    """Times as Unix seconds.

    Times of the years 1998 to 2099 are taken as they are, others as time since the recording began, at ``start_s``.

    Raises
    ------
    InputError
        No unit is given and none fits.
    """
    if unit is None:
        unit = clock_of(t)
        findings.assume(f"time in {unit} by its steps")
    seconds: Float64Array = t * CLOCKS[unit]
    if _EARLIEST_S <= seconds[0] <= _LATEST_S:
        return seconds
    if start_s is None:
        findings.assume("a clock without a date, begun on 2020-01-01 (--start tells the true moment)")
    moved: Float64Array = seconds - np.floor(seconds[0]) + (DEFAULT_START_S if start_s is None else start_s)
    return moved


def clock_of(t: Float64Array) -> str:
    """Unit of a clock by its date, or by its steps.

    Raises
    ------
    InputError
        No unit fits.
    """
    for unit, factor in CLOCKS.items():
        if _EARLIEST_S <= t[0] * factor <= _LATEST_S and t[0] * factor > 0:
            return unit
    steps = np.diff(t)
    steps = steps[steps > 0]
    step = float(np.median(steps)) if len(steps) else 0.0
    for unit, factor in CLOCKS.items():
        if _STEPS[0] <= step * factor <= _STEPS[1]:
            return unit
    raise InputError("t", f"has a median step of {step:.4g}, which is no sample interval; name the unit: --unit t=s")
