"""Maps that the crowd keeps: what sessions contribute, what of it is used, and how a change is told from a fraud."""

from app.engine.mapping.crowd.changes import ChangeEvent
from app.engine.mapping.crowd.contribution import ContributionPolicy, ContributionResult, Omission, contribute
from app.engine.mapping.crowd.policy import (
    TABLE,
    Action,
    CellState,
    ChangePolicy,
    Finding,
    PhysicsPolicy,
    Reason,
    TrustPolicy,
)
from app.engine.mapping.crowd.reduce import ReductionPolicy, reduce
from app.engine.mapping.crowd.weigh import Verdict, Weighed, weigh

__all__ = [
    "TABLE",
    "Action",
    "CellState",
    "ChangeEvent",
    "ChangePolicy",
    "ContributionPolicy",
    "ContributionResult",
    "Finding",
    "Omission",
    "PhysicsPolicy",
    "Reason",
    "ReductionPolicy",
    "TrustPolicy",
    "Verdict",
    "Weighed",
    "contribute",
    "reduce",
    "weigh",
]
