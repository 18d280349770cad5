"""Positions and what they claim."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Status(StrEnum):
    """What a fix claims."""

    OK = "ok"
    AMBIGUOUS = "ambiguous"
    INSUFFICIENT = "insufficient"
    OFF_MAP = "off_map"
    DISTURBED = "disturbed"


class FixKind(StrEnum):
    """Which samples a fix rests on, seen from its time.

    * ``filtered``: those up to its time (and the few tenths of a second that confirm a step); the answer of the moment.
    * ``fixed_lag``: also those of about five seconds after it; told that much later.
    * ``smoothed``: all of the session, before and after; for afterwards.
    """

    FILTERED = "filtered"
    FIXED_LAG = "fixed_lag"
    SMOOTHED = "smoothed"


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One of several places that fit: level, position (m, level frame), covariance (m^2), probability of being right.

    What the weights of all hypotheses lack of one is for places not listed.
    """

    level_id: str
    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    weight: float


@dataclass(frozen=True, slots=True)
class Fix:
    """One position.

    Attributes
    ----------
    t : float, s
        UTC seconds. A ``filtered`` fix uses samples up to ``t`` (and the few tenths of a second after it that
        confirm a step), never later ones.
    level_id : str
    x, y : float, m, level frame
    cov_xx, cov_xy, cov_yy : float, m^2
        Covariance whose 95 % ellipse (scale ``sqrt(5.991)``) is the promise.
    heading : float, rad
        Direction of motion, counter-clockwise from +x.
    status : Status
    quality : float
        0 (nothing known) to 1; ``sure`` marks fixes that may be acted on.
    sure : bool
    walk_on_m : float or None
        With ``insufficient``: about how many more metres are needed.
    hypotheses : tuple of Hypothesis
        While several places fit, the heaviest of them, heaviest first; given with the last fix of a segment. ``x`` and
        ``y`` are then the first one's, and the covariance is that of *all* places about it.
    kind : FixKind
        Which samples it rests on.
    """

    t: float
    level_id: str
    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    heading: float
    status: Status
    quality: float
    sure: bool
    walk_on_m: float | None = None
    hypotheses: tuple[Hypothesis, ...] = ()
    kind: FixKind = FixKind.FILTERED
