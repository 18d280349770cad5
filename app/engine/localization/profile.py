"""The steps of a session that a search looks back on."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.engine.inertial import StepEvents
from app.engine.inertial.events import FIELDS as _FIELDS


def no_steps() -> StepEvents:
    """The steps of a session that has made none."""
    number, flag = np.empty(0), np.empty(0, dtype=np.bool_)
    return StepEvents(number, number, number, number, np.empty((0, 3)), number, flag, flag, number, flag)


def join(earlier: StepEvents, later: StepEvents) -> StepEvents:
    """Both, one after the other."""
    return StepEvents(*(np.concatenate([getattr(earlier, name), getattr(later, name)]) for name in _FIELDS))


def newest(events: StepEvents, count: int) -> StepEvents:
    """The last ``count`` steps."""
    first = max(len(events) - count, 0)
    return StepEvents(*(getattr(events, name)[first:] for name in _FIELDS))


def profile_values(events: StepEvents) -> dict[str, Any]:
    """As plain values."""
    return {name: getattr(events, name) for name in _FIELDS}


def profile_from(values: dict[str, Any]) -> StepEvents:
    """Inverse of :func:`profile_values`."""
    return StepEvents(*(values[name] for name in _FIELDS))
