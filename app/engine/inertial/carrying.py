"""Changes of how a device is carried, told from the vertical in its body.

A phone that goes from the hand into a pocket turns its forward axis by some angle that has nothing to do with the
walk. Attitude survives that, the gyroscope follows the turn; what changes is the angle between device and motion. Who
puts a phone away walks straight on as a rule, so the direction of motion is held through the change, and the angle the
device turned by is taken off from there on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.engine.types import BoolArray, Float64Array

TURNED_COS = float(np.cos(np.radians(35.0)))
"""Arms and legs swing a device by less over a whole step."""
_FOLLOW = 0.2
"""Share per step by which the usual vertical follows a slow change."""


@dataclass(frozen=True, slots=True)
class Carrying:
    """How the device is held.

    Attributes
    ----------
    up : tuple of three floats
        Usual vertical in the body.
    heading, earlier : float, rad
        Mean heading of the device during the last step with that vertical and during the one before, free azimuth. The
        last one may hold the beginning of a change, so the one before is what a change is measured from.
    turned : float, rad
        What changes of carrying have turned the device by so far.
    doubtful : bool
        Whether the last step had another vertical.
    """

    up: tuple[float, float, float]
    heading: float
    earlier: float
    turned: float = 0.0
    doubtful: bool = False


def follow(
    carrying: Carrying | None, up: Float64Array, heading: Float64Array
) -> tuple[Carrying | None, Float64Array, BoolArray]:
    """Go on by some steps.

    A change shows at the first step with another vertical, and is told at the second: a glance at a watch is none.

    Parameters
    ----------
    carrying : Carrying or None
        None before the first step.
    up : array, shape (k, 3)
        Mean vertical in the body during each step.
    heading : array, shape (k,), rad
        Mean heading of the device during each step.

    Returns
    -------
    Carrying or None
    walking : array, shape (k,), rad
        Heading less what changes of carrying turned the device by; held where the vertical has just changed.
    changed : array, shape (k,), bool
        Steps at which a change is told.
    """
    walking, changed = [], []
    for vertical, now in zip(up.tolist(), heading.tolist(), strict=True):
        told, other = False, _unit(*vertical)
        if carrying is None:
            carrying = Carrying(other, now, now)
        usual = carrying.up
        if usual[0] * other[0] + usual[1] * other[1] + usual[2] * other[2] > TURNED_COS:
            mixed = _unit(*(u + _FOLLOW * (o - u) for u, o in zip(usual, other, strict=True)))
            carrying = Carrying(mixed, now, carrying.heading, carrying.turned)
            walking.append(now - carrying.turned)
        elif carrying.doubtful:
            carrying, told = Carrying(other, now, now, carrying.turned + now - carrying.earlier), True
            walking.append(now - carrying.turned)
        else:
            carrying = Carrying(usual, carrying.earlier, carrying.earlier, carrying.turned, doubtful=True)
            walking.append(carrying.earlier - carrying.turned)
        changed.append(told)
    return carrying, np.array(walking, dtype=np.float64), np.array(changed, dtype=np.bool_)


def _unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    norm = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    return x / norm, y / norm, z / norm
