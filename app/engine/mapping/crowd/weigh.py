"""What each row of a level's evidence counts for.

A pure function of all evidence near: nothing is remembered from one call to the next, so that any state of a map can be
worked out again, and taking a contributor out undoes all that he did. A row that is not used stays where it is; it is
judged anew with whatever comes later, which is how the first walker of a corridor counts once a second one has come.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from app.engine.mapping.crowd.agreement import Comparison, compare, shared_credit
from app.engine.mapping.crowd.changes import ChangeEvent, find_changes, merge_events
from app.engine.mapping.crowd.doubts import Heard, bias, contradicted
from app.engine.mapping.crowd.passes import Passes, gather
from app.engine.mapping.crowd.physics import implausible
from app.engine.mapping.crowd.policy import Action, CellState, Finding, Reason, TrustPolicy
from app.engine.mapping.crowd.reputation import posterior, prior_counts
from app.engine.mapping.model import MapModel
from app.engine.types import BoolArray, Evidence, Float64Array, SourceKind

_NOBODY: Mapping[str, float] = MappingProxyType({})
_STATES = np.array([CellState.UNMAPPED, CellState.CROWD, CellState.SURVEYED], dtype=object)
_CROWD = 2
"""Others who make a cell the crowd's; with one other alone it is new."""
_BY_OTHERS = (Reason.BIASED, Reason.CONTRADICTED, Reason.MISPLACED, Reason.REPUTATION)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a session's contribution.

    Attributes
    ----------
    source_id, contributor : str
    action : Action
        That of most of its cells.
    cells : tuple of (Action, int)
        How many of its cells each action was taken on.
    agreed, judged : int
        Cells where it could be compared with independent ones, and those where it agreed.
    bias : tuple of float, uT
        Mean residual to the others, per channel.
    reason : Reason or None
        Why it is not used, or in part.
    """

    source_id: str
    contributor: str
    action: Action
    cells: tuple[tuple[Action, int], ...]
    agreed: int
    judged: int
    bias: tuple[float, ...]
    reason: Reason | None


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Evidence with its weights, and how they came about.

    Attributes
    ----------
    evidence : Evidence
        The same rows in the same order; ``weight`` is new.
    verdicts : tuple of Verdict
        One a session.
    changes : tuple of ChangeEvent
    reputation : dict of str to float
        Of each contributor of a session after this evidence, 0 to the policy's cap.
    """

    evidence: Evidence
    verdicts: tuple[Verdict, ...]
    changes: tuple[ChangeEvent, ...]
    reputation: dict[str, float]


@dataclass(slots=True)
class _Ledger:
    """The account while it is drawn up; arrays per pass unless said otherwise.

    ``bad`` per source: the reason to use nothing of it. ``trust`` per pass: reputation of its contributor (1: survey).
    ``old``: overtaken by a change. ``new``: tells of a change.
    """

    passes: Passes
    bad: dict[int, Reason]
    trust: Float64Array
    old: BoolArray
    new: BoolArray
    comparison: Comparison

    def is_bad(self) -> BoolArray:
        """Passes of sources that are not used."""
        return np.isin(self.passes.source, list(self.bad))

    def agrees(self, policy: TrustPolicy) -> BoolArray:
        """Passes that agree with the others, as far as there are any."""
        return self.new | (self.comparison.misfit <= policy.disagree)

    def judged(self, policy: TrustPolicy) -> BoolArray:
        """Passes that can be compared and are no history."""
        return ~self.old & (self.comparison.explained >= policy.explained)

    def heard(self, policy: TrustPolicy) -> Heard:
        """Sessions as they compare with others."""
        judged = self.judged(policy) & ~self.passes.survey
        return Heard(self.passes, self.comparison, judged, self.agrees(policy), self.new)


def weigh(
    evidence: Evidence,
    policy: TrustPolicy | None = None,
    *,
    model: MapModel,
    reputation: Mapping[str, float] = _NOBODY,
) -> Weighed:
    """Weights of all rows, anew.

    Parameters
    ----------
    evidence : Evidence
        Of a level or of a part of it. For a part, the ground about it (two metres) belongs to it, and a source is
        judged by what is there of it.
    policy : TrustPolicy or None
    model : MapModel
        Of the level: what is expected of the field and of a walk's errors.
    reputation : mapping of str to float
        What is known of contributors from elsewhere, 0 to 1; who is not in it is new.

    Returns
    -------
    Weighed
        Rows of sessions get weights from 0 to 1, those of surveys 1, or 0 where a change has overtaken them. Rows that
        are no numbers get 0.
    """
    policy = policy or TrustPolicy()
    finite = np.flatnonzero(np.isfinite(np.column_stack([evidence.values, evidence.xy])).all(axis=1))
    if len(finite) < len(evidence):
        rest = weigh(evidence.subset(finite), policy, model=model, reputation=reputation)
        weights = np.zeros(len(evidence), np.float32)
        weights[finite] = rest.evidence.weight
        return replace(rest, evidence=replace(evidence, weight=weights))
    if not len(evidence):
        return Weighed(evidence, (), (), {})
    passes = gather(evidence, model, policy.cell_m)
    bad = {} if policy.physics is None else implausible(evidence, model, policy.physics)
    ledger = _open(passes, evidence, bad, model, reputation, policy)
    changes: list[ChangeEvent] = []
    if policy.agreement:
        _form_consensus(ledger, evidence, model, reputation, policy)
    if policy.change is not None:
        changes = _follow_changes(ledger, model, policy)
    if policy.agreement:
        _form_consensus(ledger, evidence, model, reputation, policy)
    actions = _actions(ledger, policy)
    weight = _weights(ledger, actions, policy)[passes.of_row]
    weighed = replace(evidence, weight=weight.astype(np.float32))
    return Weighed(
        weighed, _verdicts(ledger, actions, evidence, model, policy), tuple(changes), _told(ledger, evidence)
    )


def _open(
    passes: Passes,
    evidence: Evidence,
    bad: dict[int, Reason],
    model: MapModel,
    reputation: Mapping[str, float],
    policy: TrustPolicy,
) -> _Ledger:
    n = len(passes)
    nothing = np.zeros(n, dtype=np.bool_)
    trust = _trust(passes, evidence, nothing, nothing, reputation, policy)
    bad = {**bad, **_distrusted(passes, trust, policy)}
    lead = np.where(passes.survey, 1.0, trust / policy.survey_lead)
    credit = np.where(np.isin(passes.source, list(bad)), 0.0, lead)
    return _Ledger(passes, bad, trust, nothing, nothing.copy(), compare(passes, model.covariance, credit))


def _distrusted(passes: Passes, trust: Float64Array, policy: TrustPolicy) -> dict[int, Reason]:
    sources = np.unique(passes.source[trust < policy.reputation_floor])
    return dict.fromkeys(sources.tolist(), Reason.REPUTATION)


def _trust(
    passes: Passes,
    evidence: Evidence,
    agreed: BoolArray,
    judged: BoolArray,
    reputation: Mapping[str, float],
    policy: TrustPolicy,
) -> Float64Array:
    """Reputation of each pass's contributor, shape (p,); what his keys and devices said counts together."""
    n = int(passes.witness.max()) + 1
    priors = np.array([prior_counts(s.contributor, reputation, policy) for s in evidence.sources])
    sources, first = np.unique(passes.source, return_index=True)
    best_first = np.argsort(-priors[sources, 0] / priors[sources].sum(axis=1), kind="stable")
    prior = np.tile(policy.reputation_prior, (n, 1))
    prior[passes.witness[first[best_first]]] = priors[sources[best_first]]  # of several names the worst one stays
    told = posterior(
        (prior[:, 0], prior[:, 1]),
        np.bincount(passes.witness, agreed & judged, n).astype(np.float64),
        np.bincount(passes.witness, judged, n).astype(np.float64),
        policy,
    )
    return np.where(passes.survey, 1.0, told[passes.witness])


def _form_consensus(
    ledger: _Ledger, evidence: Evidence, model: MapModel, reputation: Mapping[str, float], policy: TrustPolicy
) -> None:
    """Who agrees with whom, found in rounds: those who disagree lose their say, and the others are compared anew.

    A pass that disagrees counts the less the more it does (Huber's weights), so that the first rounds, in which nobody
    knows who is right, do not turn out those who are.
    """
    passes = ledger.passes
    physics = {i: reason for i, reason in ledger.bad.items() if reason not in _BY_OTHERS}
    for _ in range(policy.rounds):
        misfit = np.where(ledger.new, 0.0, ledger.comparison.misfit)
        robust = np.minimum(1.0, policy.disagree / np.maximum(misfit, 1e-9))
        credit = np.where(passes.survey, 1.0, ledger.trust * robust)
        credit = np.where(ledger.is_bad() | ledger.old, 0.0, credit)
        ledger.comparison = compare(passes, model.covariance, credit)
        heard = ledger.heard(policy)
        ledger.trust = _trust(passes, evidence, heard.agreed, heard.judged, reputation, policy)
        ledger.bad = {**_distrusted(passes, ledger.trust, policy), **contradicted(heard, model, policy), **physics}


def _follow_changes(ledger: _Ledger, model: MapModel, policy: TrustPolicy) -> list[ChangeEvent]:
    """Changes one after another: each makes what was before it history."""
    events: list[ChangeEvent] = []
    if policy.change is None:
        return events
    passes = ledger.passes
    for _ in range(policy.change.rounds):
        credit = np.where(ledger.is_bad() | ledger.old, 0.0, ledger.trust)
        found, overtaken = find_changes(passes, credit, model, policy.change)
        if not found:
            break
        ledger.old = ledger.old | overtaken.old
        ledger.new = (ledger.new | overtaken.new) & ~ledger.old
        events += found
    credit = np.where(ledger.is_bad() | ledger.old, 0.0, ledger.trust)
    ledger.comparison = compare(passes, model.covariance, credit)
    return merge_events(events)


def _actions(ledger: _Ledger, policy: TrustPolicy) -> np.ndarray[tuple[int], np.dtype[np.object_]]:
    """Action of the policy's table for each pass, shape (p,)."""
    comparison = ledger.comparison
    known = comparison.explained >= policy.explained
    crowd = known & (comparison.others >= _CROWD)
    state = np.where(comparison.surveyed & known, _STATES[2], np.where(crowd, _STATES[1], _STATES[0]))
    finding = np.where(ledger.agrees(policy), Finding.AGREES, Finding.DISAGREES).astype(object)
    finding[~known] = Finding.ALONE
    if not policy.agreement:
        finding[:] = Finding.AGREES
    finding[ledger.new | ledger.old] = Finding.PERSISTS
    for source, reason in ledger.bad.items():
        physics = reason not in _BY_OTHERS
        finding[ledger.passes.source == source] = Finding.IMPLAUSIBLE if physics else Finding.DISTRUSTED
    return np.array([policy.table[s, f] for s, f in zip(state, finding, strict=True)], dtype=object)


def _weights(ledger: _Ledger, actions: np.ndarray, policy: TrustPolicy) -> Float64Array:
    """Weight of the rows of each pass."""
    passes = ledger.passes
    used = np.array([action.used for action in actions]) & ~ledger.old
    graded = np.minimum(1.0, policy.graded / np.maximum(ledger.comparison.misfit, 1e-9)) if policy.agreement else 1.0
    credit = np.where(passes.survey, ~ledger.old, used * ledger.trust * np.where(ledger.new, 1.0, graded))
    shared = shared_credit(passes, credit.astype(np.float64))
    return np.where(passes.survey, credit, shared)


def _verdicts(
    ledger: _Ledger, actions: np.ndarray, evidence: Evidence, model: MapModel, policy: TrustPolicy
) -> tuple[Verdict, ...]:
    passes = ledger.passes
    heard = ledger.heard(policy)
    judged, agreed = heard.judged, heard.judged & heard.agreed
    mean, _ = bias(heard, policy)
    by_source = np.argsort(passes.source, kind="stable")
    owners, first = np.unique(passes.source[by_source], return_index=True)
    verdicts = []
    for i, rows in zip(owners.tolist(), np.split(by_source, first[1:]), strict=True):
        source = evidence.sources[i]
        if source.kind is SourceKind.SURVEY:
            continue
        counts = Counter(actions[rows]).most_common()
        reason = ledger.bad.get(i)
        if reason is None and not judged[rows].any():
            reason = Reason.ALONE
        verdicts.append(
            Verdict(
                source_id=source.id,
                contributor=source.contributor,
                action=counts[0][0],
                cells=tuple(counts),
                agreed=int(agreed[rows].sum()),
                judged=int(judged[rows].sum()),
                bias=tuple(float(v) for v in mean[i] * model.level.sd),
                reason=reason,
            )
        )
    return tuple(verdicts)


def _told(ledger: _Ledger, evidence: Evidence) -> dict[str, float]:
    """Reputation by contributor; who contributed sessions and has a name."""
    sources, first = np.unique(ledger.passes.source, return_index=True)
    return {
        evidence.sources[i].contributor: float(ledger.trust[row])
        for i, row in zip(sources.tolist(), first.tolist(), strict=True)
        if evidence.sources[i].kind is SourceKind.SESSION and evidence.sources[i].contributor
    }
