"""What a matcher answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from app.engine.matching.problem import MatchProblem
from app.engine.types import Float64Array, Status


@dataclass(frozen=True, slots=True)
class Candidate:
    """One placement of the track that a search found, before it is judged.

    Attributes
    ----------
    x, y : array, shape (n,), m, level frame
        Where it puts each point of the track.
    cost : float
        The search's own measure; less is better. Only the order of costs of one search means anything.
    rotation : float, rad
        By which it turned the track, counter-clockwise.
    scale : float
        By which it stretched the track.
    cov : array, shape (2, 2), m^2, or None
        Of the last point, where the search knows it better than the shape of the map tells.
    bending : float
        Chi-square of the errors of motion that a track which was bent into place takes to be so; 0 for a rigid one.
    """

    x: Float64Array
    y: Float64Array
    cost: float
    rotation: float = 0.0
    scale: float = 1.0
    cov: Float64Array | None = None
    bending: float = 0.0


@dataclass(frozen=True, slots=True)
class LocatedTrack:
    """A hypothesis: the track at its place.

    Attributes
    ----------
    x, y : array, shape (n,), m, level frame
    cov : array, shape (2, 2), m^2
        Covariance of the last point if this is the right place.
    weight : float
        Probability of being the right place; what all weights lack of one is for places not listed.
    rotation : float, rad
    scale : float
    cost : float
        The search's own measure.
    """

    x: Float64Array
    y: Float64Array
    cov: Float64Array
    weight: float
    rotation: float
    scale: float
    cost: float


@dataclass(frozen=True, slots=True)
class Evidence:
    """Why a result has its status.

    Attributes
    ----------
    evaluated : int
        Placements whose cost was computed.
    residual_rms : float, uT
        Of the best placement, after the sensor's offset.
    expected_rms : float, uT
        What map, walk and sensor account for.
    mapped : float
        Share of the best placement that lies on mapped ground.
    information_m : float, m
        Major semi-axis (one sigma) of the position that the field alone gives at the best placement; infinite where
        the track runs along contours.
    iterations : int
        Of iterative methods; 0 for the others.
    converged : bool
        Whether an iterative method came to rest, or a search came to its end before the deadline.
    note : str
        In words, where there is more to say.
    """

    evaluated: int
    residual_rms: float
    expected_rms: float
    mapped: float
    information_m: float
    iterations: int = 0
    converged: bool = True
    note: str = ""


@dataclass(frozen=True, slots=True)
class MatchResult:
    """Answer of a matcher.

    Attributes
    ----------
    status : Status
        ``ok``: one place; ``ambiguous``: several; ``insufficient``: the field does not tell; ``off_map``.
    matches : tuple of LocatedTrack
        Heaviest first; empty if nothing was found.
    evidence : Evidence
    walk_on_m : float or None, m
        With ``insufficient`` and ``ambiguous``: about how far to go on.
    """

    status: Status
    matches: tuple[LocatedTrack, ...]
    evidence: Evidence
    walk_on_m: float | None = None


class Matcher(Protocol):
    """A batch method: a profile along a track is put in its place on a map.

    A matcher holds parameters only; the same problem always has the same answer.
    """

    def match(self, problem: MatchProblem) -> MatchResult:
        """Locate the track.

        Raises
        ------
        InputError
            The problem lacks what the method needs (features, routes, a region); names the field.
        """
        ...
