"""From a closed session to the map: what is offered, updates that take it in, review, changes of the field."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from app.engine.mapping.crowd.changes import ChangeEvent
from app.engine.mapping.crowd.policy import Action, Reason
from app.engine.mapping.crowd.weigh import Verdict
from app.engine.types import Evidence, EvidenceSource, FeatureSet, MapBuild, SourceKind, WalkReport
from app.services.errors import ConflictError, NotFoundError
from app.services.records import (
    Contribution,
    ContributionState,
    Job,
    JobKind,
    JobState,
    Level,
    MapInfo,
    MapKind,
    NewBuild,
    Session,
)
from app.services.tasks import BuildResult, BuildSpec, ContributeResult, Offer
from tests.support.builders import World, grid_map, locate_result, new_segment, new_walk

OFFERED, USED, WAITING, QUARANTINED, REJECTED, EMPTY = ContributionState
MODEL = {
    "level": {"mean": [0.0, 20.0, -40.0], "sd": [5.0, 5.0, 6.0]},
    "covariance": {"length_m": 5.0},
    "align": True,
}


def vector_build(level_id: str, seed: int = 0) -> MapBuild:
    built = grid_map(level_id, seed=seed, features=FeatureSet.VECTOR)
    return MapBuild(built, (), 100, 5.0, (5.0, 5.0, 6.0), Evidence.empty(FeatureSet.VECTOR), MODEL)


def build(world: World, level_id: str, survey_ids: tuple[str, ...] = ()) -> None:
    """A vector map that can be updated, with all walks of the level (or of these surveys) in it."""
    world.services.maps.request_build(NewBuild(level_id, survey_ids=survey_ids))
    (job,) = world.services.processing.claim(1, JobKind.BUILD_MAP)
    walks = [new.walk.walk_id for new in world.services.processing.build_spec(job).walks]
    made = vector_build(level_id)
    made = replace(made, walks=tuple(WalkReport(walk, 10, 5.0, (0.0, 0.0, 0.0), 1.0) for walk in walks))
    world.services.processing.complete_build(job, BuildResult(made, 0.5), 0.6)


def mapped(world: World) -> Level:
    level = world.surveyed_level()
    build(world, level.id)
    return world.services.venues.get_level(level.id)


def closed_session(world: World, level_id: str, contributor: str | None = "key_1") -> Session:
    session = world.services.sessions.create(level_id, "particle", {}, contributor=contributor)
    world.services.sessions.accept(session.id, new_segment(0))
    (job,) = world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    world.services.sessions.close(session.id)
    world.services.processing.complete_locate(job, locate_result(0, level_id=level_id))
    return session


def rows(id_: str, contributor: str = "key_1") -> Evidence:
    at = np.array([[2.0, 3.0], [2.5, 3.0], [3.0, 3.5]])
    source = EvidenceSource(id_, SourceKind.SESSION, contributor=contributor, t=1.7e9)
    return Evidence.of(FeatureSet.VECTOR, source, at, np.tile([1.0, 21.0, -41.0], (3, 1)), 0.8)


def contribute(world: World, evidence: Evidence | None = None) -> Job | None:
    (job,) = world.services.processing.claim(1, JobKind.CONTRIBUTE)
    spec = world.services.processing.contribute_spec(job)
    offered = rows(spec.contribution_id, spec.contributor) if evidence is None else evidence
    offer = Offer(spec.smooth.maps[0].level_id, offered, 40, 3 if len(offered) else 0, ("37 steps: not sure",))
    return world.services.processing.complete_contribute(job, ContributeResult((offer,), 0.2))


def offered(world: World, level: Level) -> Contribution:
    """A contribution that waits for the update it caused."""
    closed_session(world, level.id)
    contribute(world)
    (one,) = world.services.contributions.list(level_id=level.id, limit=1).items
    return one


def run_update(
    world: World, verdicts: tuple[Verdict, ...] = (), changes: tuple[ChangeEvent, ...] = ()
) -> tuple[BuildSpec, MapInfo]:
    (job,) = world.services.processing.claim(1, JobKind.BUILD_MAP)
    spec = world.services.processing.build_spec(job)
    assert spec.base is not None
    made = vector_build(spec.level_id, seed=len(spec.walks) + 1)
    evidence = spec.base.contributed or Evidence.empty(FeatureSet.VECTOR)
    result = BuildResult(replace(made, evidence=evidence), 0.1, spec.base, verdicts, changes)
    assert world.services.processing.complete_build(job, result, 0.2).state is JobState.DONE
    return spec, world.services.maps.current(spec.level_id)


def verdict(id_: str, action: Action, *, reason: Reason | None = None, cells: int = 3, agreed: int = 2) -> Verdict:
    return Verdict(id_, "key_1", action, ((action, cells),), agreed, 3, (0.0, 0.0, 0.0), reason)


def test_a_session_offers_what_it_saw_once_it_is_over(world: World) -> None:
    level = mapped(world)
    session = closed_session(world, level.id)
    (job,) = world.services.processing.claim(1, JobKind.CONTRIBUTE)
    spec = world.services.processing.contribute_spec(job)
    assert (spec.contributor, spec.contribution_id[:4], len(spec.smooth.segments)) == ("key_1", "ctr_", 1)
    offer = Offer(level.id, rows(spec.contribution_id), 40, 3, ("37 steps: not sure",))
    done = world.services.processing.complete_contribute(job, ContributeResult((offer,), 0.2))
    assert done is not None
    assert (done.state, done.result["n_rows"]) == (JobState.DONE, 3)
    (one,) = world.services.contributions.list(session_id=session.id).items
    assert one == world.services.contributions.get(spec.contribution_id)
    assert (one.state, one.level_id, one.contributor, one.map_id) == (OFFERED, level.id, "key_1", level.current_map_id)
    assert (one.n_steps, one.n_kept, one.n_rows, one.reasons) == (40, 3, 3, ("37 steps: not sure",))
    assert one.box == (2.0, 3.0, 3.0, 3.5)


def test_a_session_that_did_not_opt_in_offers_nothing(world: World) -> None:
    closed_session(world, mapped(world).id, contributor=None)
    assert world.services.processing.claim(5, JobKind.CONTRIBUTE) == ()


def test_closing_twice_offers_once(world: World) -> None:
    session = closed_session(world, mapped(world).id)
    world.services.sessions.close(session.id)
    contribute(world)
    world.services.sessions.close(session.id)
    assert world.services.processing.claim(5, JobKind.CONTRIBUTE) == ()


def test_a_session_without_anything_sure_is_noted_as_empty_and_updates_nothing(world: World) -> None:
    closed_session(world, mapped(world).id)
    contribute(world, Evidence.empty(FeatureSet.VECTOR))
    (one,) = world.services.contributions.list().items
    assert (one.state, one.box, one.n_rows) == (EMPTY, None, 0)
    assert world.services.processing.claim(5, JobKind.BUILD_MAP) == ()


def test_an_update_takes_in_what_was_offered_and_notes_the_verdict(world: World) -> None:
    level = mapped(world)
    one = offered(world, level)
    spec, info = run_update(world, (verdict(one.id, Action.CONFIRM),))
    assert spec.base is not None
    assert spec.base.contributed is not None
    assert [source.id for source in spec.base.contributed.sources] == [one.id]
    assert (info.kind, info.added, info.parent_id) == (MapKind.UPDATE, (one.id,), level.current_map_id)
    judged = world.services.contributions.get(one.id)
    assert (judged.state, judged.n_agreed, judged.n_disagreed) == (USED, 2, 1)
    assert judged.verdict == "3 of 3 square metres used (confirm 3)"
    assert world.services.processing.claim(5, JobKind.BUILD_MAP) == (), "nothing is new any more"


@pytest.mark.parametrize(
    ("action", "reason", "state", "words"),
    [
        (Action.QUARANTINE, Reason.ALONE, WAITING, "nobody else"),
        (Action.QUARANTINE, Reason.CONTRADICTED, QUARANTINED, "others read another field"),
        (Action.BLOCK, Reason.AMPLITUDE, QUARANTINED, "stronger"),
        (Action.NEW, None, USED, "new 3"),
    ],
)
def test_verdicts_in_words(
    world: World, action: Action, reason: Reason | None, state: ContributionState, words: str
) -> None:
    one = offered(world, mapped(world))
    run_update(world, (verdict(one.id, action, reason=reason),))
    judged = world.services.contributions.get(one.id)
    assert judged.state is state
    assert words in judged.verdict


def test_a_later_update_may_judge_an_earlier_contribution_anew(world: World) -> None:
    level = mapped(world)
    first = offered(world, level)
    run_update(world, (verdict(first.id, Action.QUARANTINE, reason=Reason.ALONE),))
    second = offered(world, level)
    run_update(world, (verdict(first.id, Action.NEW), verdict(second.id, Action.NEW)))
    assert [one.state for one in world.services.contributions.list(state=USED).items] == [USED, USED]


def test_a_rejected_contribution_is_taken_out_and_may_be_restored(world: World) -> None:
    level = mapped(world)
    one = offered(world, level)
    run_update(world, (verdict(one.id, Action.CONFIRM),))
    rejected = world.services.contributions.reject(one.id)
    assert (rejected.state, rejected.verdict) == (REJECTED, "")
    spec, info = run_update(world)
    assert spec.base is not None
    assert (spec.base.removed, info.removed, spec.base.contributed) == ((one.id,), (one.id,), None)
    assert world.services.contributions.restore(one.id).state is OFFERED
    with pytest.raises(ConflictError, match="offered, not rejected"):
        world.services.contributions.restore(one.id)
    spec, _ = run_update(world, (verdict(one.id, Action.CONFIRM),))
    assert spec.base is not None
    assert (spec.base.removed, spec.base.added) == ((), (one.id,))


def test_weighing_does_not_overrule_a_person(world: World) -> None:
    one = offered(world, mapped(world))
    world.services.contributions.reject(one.id)
    with world.database(write=True) as uow:
        from app.services.reviews import verdict_of

        uow.contributions.decide([verdict_of(verdict(one.id, Action.CONFIRM))], datetime.now(UTC))
    assert world.services.contributions.get(one.id).state is REJECTED


def test_a_deleted_contribution_is_gone_and_taken_out(world: World) -> None:
    one = offered(world, mapped(world))
    run_update(world, (verdict(one.id, Action.CONFIRM),))
    world.services.contributions.delete(one.id)
    with pytest.raises(NotFoundError):
        world.services.contributions.get(one.id)
    spec, _ = run_update(world)
    assert spec.base is not None
    assert spec.base.removed == (one.id,)


def test_an_update_whose_base_was_overtaken_is_done_again(world: World) -> None:
    level = mapped(world)
    offered(world, level)
    (job,) = world.services.processing.claim(1, JobKind.BUILD_MAP)
    spec = world.services.processing.build_spec(job)
    with world.database(write=True) as uow:
        packed = uow.maps.pack(grid_map(level.id, seed=9, features=FeatureSet.VECTOR))
        current = uow.maps.get(str(level.current_map_id))
        uow.maps.add(replace(current, id="map_x", version=9, hash=packed.hash), packed)
        uow.levels.set_current_map(level.id, "map_x", datetime.now(UTC))
    result = BuildResult(vector_build(level.id), 0.1, spec.base)
    again = world.services.processing.complete_build(job, result, 0.2)
    assert again.state is JobState.QUEUED
    assert world.services.maps.current(level.id).id == "map_x"


def test_a_full_build_is_followed_by_an_update_with_the_contributions(world: World) -> None:
    level = mapped(world)
    one = offered(world, level)
    run_update(world, (verdict(one.id, Action.CONFIRM),))
    build(world, level.id)
    spec, info = run_update(world, (verdict(one.id, Action.CONFIRM),))
    assert spec.base is not None
    assert (spec.base.added, info.added) == ((one.id,), (one.id,))


def test_new_and_deleted_walks_are_what_an_update_is_about(world: World) -> None:
    level = mapped(world)
    with pytest.raises(ConflictError, match="up to date"):
        world.services.maps.request_build(NewBuild(level.id, mode=MapKind.UPDATE))
    (survey,) = world.services.surveys.list(level.id).items
    (old,) = world.services.surveys.list_walks(survey.id).items
    new, _ = world.services.surveys.add_walk(survey.id, new_walk(seed=5))
    world.services.surveys.delete_walk(survey.id, old.id)
    world.services.maps.request_build(NewBuild(level.id, mode=MapKind.UPDATE))
    spec, info = run_update(world)
    assert spec.base is not None
    assert [one.walk.walk_id for one in spec.walks] == [new.id]
    assert (spec.base.removed, info.removed) == ((old.id,), (old.id,))


def test_a_map_without_its_evidence_cannot_be_updated(world: World) -> None:
    level = world.mapped_level()  # of the features hv
    (survey,) = world.services.surveys.list(level.id).items
    world.services.surveys.add_walk(survey.id, new_walk(seed=5))
    with pytest.raises(ConflictError, match="build it once more"):
        world.services.maps.request_build(NewBuild(level.id, mode=MapKind.UPDATE))


def test_a_change_is_noted_once(world: World) -> None:
    level = mapped(world)
    event = ChangeEvent(((20.5, 8.5), (21.5, 8.5)), 1.0, 1.7e9, 1.7e9 + 3600.0, (0.5, -1.0, 14.0), 4)
    one = offered(world, level)
    _, info = run_update(world, (verdict(one.id, Action.CHANGE),), (event,))
    (change,) = world.services.contributions.changes(level_id=level.id).items
    assert (change.map_id, change.box, change.area_m2) == (info.id, (20.0, 8.0, 22.0, 9.0), 2.0)
    assert (change.after, change.before) == (
        datetime.fromtimestamp(1.7e9, UTC),
        datetime.fromtimestamp(1.7e9 + 3600.0, UTC),
    )
    offered(world, level)
    narrower = replace(event, after_t=1.7e9 + 600.0)
    elsewhere = replace(event, cells=((40.5, 8.5),))
    run_update(world, (), (narrower, elsewhere))
    boxes = [c.box for c in world.services.contributions.changes(level_id=level.id).items]
    assert sorted(boxes) == [(20.0, 8.0, 22.0, 9.0), (40.0, 8.0, 41.0, 9.0)]
    assert world.services.contributions.changes(level_id="lvl_none").items == ()


def test_after_a_roll_back_maps_change_only_when_asked(world: World) -> None:
    level = mapped(world)
    one = offered(world, level)
    run_update(world, (verdict(one.id, Action.CONFIRM),))
    world.services.versions.publish(level.id, str(level.current_map_id), note="bad walk")
    offered(world, level)
    assert world.services.processing.claim(5, JobKind.BUILD_MAP) == ()
    assert world.services.maps.current(level.id).id == level.current_map_id
    world.services.contributions.reject(one.id)
    world.services.maps.request_build(NewBuild(level.id, mode=MapKind.UPDATE))
    spec, _ = run_update(world)
    assert spec.base is not None
    assert len(spec.base.added) == 1
    assert one.id not in spec.base.added
    offered(world, level)
    run_update(world)


def test_an_update_queued_before_a_roll_back_is_not_made(world: World) -> None:
    level = mapped(world)
    one = offered(world, level)
    run_update(world, (verdict(one.id, Action.CONFIRM),))
    offered(world, level)
    world.services.versions.publish(level.id, str(level.current_map_id), note="bad walk")
    (job,) = world.services.processing.claim(1, JobKind.BUILD_MAP)
    with pytest.raises(ConflictError, match="older map"):
        world.services.processing.build_spec(job)


def test_an_update_that_nobody_asked_for_keeps_to_the_surveys_of_the_map(world: World) -> None:
    level = mapped(world)
    other = world.services.surveys.create(level.id, "other")
    (survey,) = (one for one in world.services.surveys.list(level.id).items if one.id != other.id)
    world.services.surveys.add_walk(other.id, new_walk(seed=5))
    build(world, level.id, survey_ids=(survey.id,))
    assert world.services.processing.claim(5, JobKind.BUILD_MAP) == ()
    offered(world, level)
    spec, _ = run_update(world)
    assert spec.walks == ()


def test_contributions_that_came_while_a_draft_waited_are_taken_in(world: World) -> None:
    level = mapped(world)
    world.services.maps.request_build(NewBuild(level.id, publish=False))
    offered(world, level)
    assert len(world.services.processing.claim(1, JobKind.BUILD_MAP)) == 1
    with world.database() as uow:
        assert uow.maps.awaits_build(level.id)


def test_contributions_that_waited_for_a_build_that_fails_are_taken_in(world: World) -> None:
    level = mapped(world)
    job = world.services.maps.request_build(NewBuild(level.id))
    one = offered(world, level)
    world.services.jobs.cancel(job.id)
    spec, _ = run_update(world)
    assert spec.base is not None
    assert spec.base.added == (one.id,)


def test_what_an_update_saw_a_part_of_keeps_its_verdict(world: World) -> None:
    level = mapped(world)
    one = offered(world, level)
    run_update(world, (verdict(one.id, Action.CONFIRM),))
    closed_session(world, level.id)
    (job,) = world.services.processing.claim(1, JobKind.CONTRIBUTE)
    spec = world.services.processing.contribute_spec(job)
    far = rows(spec.contribution_id)
    offer = Offer(level.id, replace(far, xy=far.xy + np.float32(500.0)), 40, 3, ())
    world.services.processing.complete_contribute(job, ContributeResult((offer,), 0.2))
    run_update(world, (verdict(one.id, Action.QUARANTINE, reason=Reason.CONTRADICTED),))
    assert world.services.contributions.get(one.id).state is USED


def test_a_contribution_that_is_taken_out_was_no_walk(world: World) -> None:
    level = mapped(world)
    walks = world.services.maps.current(level.id).n_walks
    one = offered(world, level)
    run_update(world)
    world.services.contributions.reject(one.id)
    _, info = run_update(world)
    assert info.removed == (one.id,)
    assert info.n_walks == walks


def test_an_empty_contribution_is_empty_when_it_is_restored(world: World) -> None:
    closed_session(world, mapped(world).id)
    contribute(world, Evidence.empty(FeatureSet.VECTOR))
    (one,) = world.services.contributions.list().items
    world.services.contributions.reject(one.id)
    assert world.services.contributions.restore(one.id).state is EMPTY
