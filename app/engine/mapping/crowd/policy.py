"""What is done with a contribution: a table from what the map knows and what the contribution says to an action.

After the station states of ichnaea (``ichnaea/data/station.py``: new, change, confirm, replace, block), which knows one
position a station; a map has a field, so the table is applied to every cell that a contribution touches.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType


class CellState(StrEnum):
    """What others than the contributor have told of a cell and of the ground next to it.

    ``unmapped``: nobody, or one other alone; ``crowd``: sessions of two others or more; ``surveyed``: a survey.
    """

    UNMAPPED = "unmapped"
    CROWD = "crowd"
    SURVEYED = "surveyed"


class Finding(StrEnum):
    """How what a contribution says of a cell compares with what others say."""

    ALONE = "alone"
    AGREES = "agrees"
    DISAGREES = "disagrees"
    PERSISTS = "persists"
    DISTRUSTED = "distrusted"
    IMPLAUSIBLE = "implausible"


class Action(StrEnum):
    """What is done with the rows."""

    NEW = "new"
    CONFIRM = "confirm"
    REFINE = "refine"
    CHANGE = "change"
    QUARANTINE = "quarantine"
    BLOCK = "block"

    @property
    def used(self) -> bool:
        """Whether rows count for the map."""
        return self not in (Action.QUARANTINE, Action.BLOCK)


Table = Mapping[tuple[CellState, Finding], Action]

TABLE: Table = MappingProxyType(
    {
        (CellState.UNMAPPED, Finding.ALONE): Action.QUARANTINE,
        (CellState.UNMAPPED, Finding.AGREES): Action.NEW,
        (CellState.UNMAPPED, Finding.DISAGREES): Action.QUARANTINE,
        (CellState.UNMAPPED, Finding.PERSISTS): Action.CHANGE,
        (CellState.UNMAPPED, Finding.DISTRUSTED): Action.QUARANTINE,
        (CellState.UNMAPPED, Finding.IMPLAUSIBLE): Action.BLOCK,
        (CellState.CROWD, Finding.ALONE): Action.QUARANTINE,
        (CellState.CROWD, Finding.AGREES): Action.REFINE,
        (CellState.CROWD, Finding.DISAGREES): Action.QUARANTINE,
        (CellState.CROWD, Finding.PERSISTS): Action.CHANGE,
        (CellState.CROWD, Finding.DISTRUSTED): Action.QUARANTINE,
        (CellState.CROWD, Finding.IMPLAUSIBLE): Action.BLOCK,
        (CellState.SURVEYED, Finding.ALONE): Action.QUARANTINE,
        (CellState.SURVEYED, Finding.AGREES): Action.CONFIRM,
        (CellState.SURVEYED, Finding.DISAGREES): Action.QUARANTINE,
        (CellState.SURVEYED, Finding.PERSISTS): Action.CHANGE,
        (CellState.SURVEYED, Finding.DISTRUSTED): Action.QUARANTINE,
        (CellState.SURVEYED, Finding.IMPLAUSIBLE): Action.BLOCK,
    }
)
"""The policy. ``new``: first evidence of a cell, two contributors agree on it. ``quarantine``: kept, not used, judged
anew whenever evidence comes. ``block``: against physics; judged anew as well, but no agreement helps."""


class Reason(StrEnum):
    """Why a source, or part of it, is not used."""

    AMPLITUDE = "amplitude"
    JUMP = "jump"
    ROUGH = "rough"
    SMOOTH = "smooth"
    CURL = "curl"
    BIASED = "biased"
    CONTRADICTED = "contradicted"
    MISPLACED = "misplaced"
    REPUTATION = "reputation"
    ALONE = "alone"

    @property
    def words(self) -> str:
        """For people."""
        return _WORDS[self]


_WORDS = {
    Reason.AMPLITUDE: "the field is stronger than a building's can be",
    Reason.JUMP: "the field jumps between neighbouring places as no field does",
    Reason.ROUGH: "the field is rougher along the way than this level's",
    Reason.SMOOTH: "the field hardly changes along the way, as if nobody had walked",
    Reason.CURL: "the field along a closed way does not add up to nothing",
    Reason.BIASED: "the field differs by one and the same offset from what others read",
    Reason.CONTRADICTED: "others read another field at most of these places",
    Reason.MISPLACED: "the field agrees with that of these places no better than with that of others",
    Reason.REPUTATION: "earlier contributions of the same origin were contradicted",
    Reason.ALONE: "nobody else has been here yet",
}


@dataclass(frozen=True, slots=True)
class PhysicsPolicy:
    """What a magnetic field on a floor can be.

    Attributes
    ----------
    amplitude_ut : float, uT
        Largest magnitude (or channel). The Earth's field is at most 65 uT; a phone a hand's breadth from a steel door
        reads some 200.
    jump_ut, jump_m : float
        Rows of one source that are nearer to each other than ``jump_m`` may differ by this: steel a metre off changes
        the field by a few uT over half a metre, a passing trolley by 20.
    jumps : float
        Share of neighbouring rows that may jump.
    rough, smooth : float
        Limits of the mean squared increment over half a metre to two, over what the covariance expects. The field of
        real walks lies within 0.2 to 4 of a level's mean; a made-up constant is at 0.
    least_pairs : int
        Increments needed to judge.
    circulation : float
        Standard deviations from nought that the line integral round a closed way may have.
    """

    amplitude_ut: float = 200.0
    jump_ut: float = 30.0
    jump_m: float = 0.5
    jumps: float = 0.05
    rough: float = 8.0
    smooth: float = 0.02
    least_pairs: int = 16
    circulation: float = 6.0


@dataclass(frozen=True, slots=True)
class ChangePolicy:
    """When a disagreement that persists is a change of the field.

    Attributes
    ----------
    witnesses : int
        Independent passes of sessions after it that agree with one another and not with the map. Those of surveys do
        not count here: a survey contradicts itself where labels are wrong.
    evidence : float
        Squared difference of the means after and before, over its variance, summed over channels. 25 is met by chance
        once in 60,000 (three channels): a level has hundreds of independent places, each with several dates.
    least_ut : float, uT
        A smaller difference is not worth a change: offsets of devices are of that size.
    agreed : float
        Share of the passes on either side that must lie on their own side of the middle. Honest passes that go on
        reading the old field refute a change.
    cells : int
        Adjoining cells that a change takes; one alone is a passing trolley.
    rounds : int
        Changes of the same place one after another that are looked for.
    """

    witnesses: int = 3
    evidence: float = 25.0
    least_ut: float = 6.0
    agreed: float = 0.8
    cells: int = 2
    rounds: int = 3


@dataclass(frozen=True, slots=True)
class TrustPolicy:
    """How contributions are weighed.

    Attributes
    ----------
    cell_m : float, m
        Side of the cells that are judged. About the spread of a contributed place, and below the field's fine length.
    table : mapping of (CellState, Finding) to Action
    physics : PhysicsPolicy or None
        None: not asked.
    change : ChangePolicy or None
        None: changes are not looked for.
    agreement : bool
        Whether contributions must agree with independent ones; off, all that physics allows is used.
    explained : float
        Share of the field's variance that others' evidence must explain for a cell to be more than unmapped: somebody
        passed within a metre or so.
    disagree : float
        Mean squared residual over its variance beyond which a cell disagrees (chi-square of three channels: 0.7 %).
    graded : float
        The same beyond which a cell's rows begin to count for less: what fits badly may be wrong.
    misfit : float
        Mean of the same over all cells of a source, above which, and so many standard deviations of the mean
        (``bias_sds``), none of it is used. It is 1 where model and places are right and 2 to 4 for walks told of
        another place.
    contradicted : float
        Share of a source's judged cells that must agree; below it none of it is used.
    least_cells : int
        Judged cells needed for a verdict on a source.
    bias_ut, bias_sds : float
        A source's mean residual may be this offset, per channel, plus so many standard deviations of the mean: hard
        iron is taken off to a microtesla or two.
    alike_cells : float
        Neighbouring cells of one source that err together.
    reputation_prior : tuple of two floats
        Beta distribution (agreeing, disagreeing) of a contributor nobody knows.
    reputation_cells : float
        Judged cells (those that err together counted once) that a known reputation stands for: three walks of a
        minute. One good walk does not wash a bad name clean.
    reputation_cap : float
        Nobody counts for more: a contributor who has agreed for years may turn.
    reputation_floor : float
        Below it nothing of a contributor is used.
    survey_lead : float
        Times a session's credit that a survey starts with, before it is known who agrees with whom.
    rounds : int
        Times that the consensus is formed anew without those who disagree with it.
    """

    cell_m: float = 1.0
    table: Table = field(default_factory=lambda: TABLE)
    physics: PhysicsPolicy | None = PhysicsPolicy()
    change: ChangePolicy | None = ChangePolicy()
    agreement: bool = True
    explained: float = 0.15
    disagree: float = 4.0
    graded: float = 2.0
    misfit: float = 1.75
    contradicted: float = 0.5
    least_cells: int = 4
    bias_ut: float = 1.0
    bias_sds: float = 3.0
    alike_cells: float = 3.0
    reputation_prior: tuple[float, float] = (2.0, 1.0)
    reputation_cells: float = 60.0
    reputation_cap: float = 0.95
    reputation_floor: float = 0.3
    survey_lead: float = 2.0
    rounds: int = 3
