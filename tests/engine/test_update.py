"""Maps brought up to date: what changes, what stays, and what a rebuild would say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import MapError
from app.engine.mapping import MapModel, MapUpdate, NewWalk, build_map, update_map
from app.engine.types import Evidence, EvidenceSource, FeatureSet, MapBuild, MapBuildSettings, SourceKind, SurveyWalk
from tests.e2e.synthetic import walk

SETTINGS = MapBuildSettings(extent=(-4.0, -4.0, 29.0, 16.0))


@pytest.fixture(scope="module")
def walks() -> list[SurveyWalk]:
    """Laps that cross one another, and a last one that goes where no other went."""
    laps = [[(x, 0.0), (x, 12.0), (x + 3.0, 12.0), (x + 3.0, 0.0)] for x in (0.0, 6.0, 12.0)]
    rows = [[(0.0, y), (15.0, y), (15.0, y + 1.5), (0.0, y + 1.5)] for y in (1.0, 5.0, 9.0)]
    corner = [[(12.0, 3.0), (25.0, 3.0), (25.0, 8.0), (12.0, 8.0)]]
    return [
        walk(way, t0=1.7e9 + 1000.0 * i, seed=i).survey(f"wlk_{i}") for i, way in enumerate([*laps, *rows, *corner])
    ]


@pytest.fixture(scope="module")
def before(walks: list[SurveyWalk]) -> MapBuild:
    return build_map("lvl", walks[:-1], SETTINGS)


@pytest.fixture(scope="module")
def update(before: MapBuild, walks: list[SurveyWalk]) -> MapUpdate:
    return updated(before, walks=[NewWalk(walks[-1], contributor="key_1", device="dev_1")])


def updated(build: MapBuild, **changes: object) -> MapUpdate:
    return update_map(build.grid_map, build.evidence, MapModel.from_values(build.model), **changes)  # type: ignore[arg-type]


def test_a_new_walk_makes_its_surroundings_more_certain_and_leaves_the_rest_as_it_was(
    before: MapBuild, update: MapUpdate, walks: list[SurveyWalk]
) -> None:
    old, new = before.grid_map, update.grid_map
    assert new.shape == old.shape
    own = update.evidence.subset(
        np.array([s.id == walks[-1].walk_id for s in update.evidence.sources])[update.evidence.source]
    )
    assert len(own) > 20
    r = np.rint((own.xy[:, 1] - new.y0) / new.cell_m).astype(int)
    c = np.rint((own.xy[:, 0] - new.x0) / new.cell_m).astype(int)
    assert (new.sd[:, r, c] < old.sd[:, r, c] + 1e-6).all()
    assert (new.support[r, c] < new.cell_m).all()
    still = ~update.changed
    np.testing.assert_array_equal(new.mean[:, still], old.mean[:, still])
    np.testing.assert_array_equal(new.sd[:, still], old.sd[:, still])


def test_an_update_comes_near_to_a_build_of_all_walks(
    before: MapBuild, update: MapUpdate, walks: list[SurveyWalk]
) -> None:
    whole = build_map("lvl", walks, replace(SETTINGS, extent=before.grid_map.extent)).grid_map
    mapped = whole.mapped & ~before.grid_map.mapped
    assert mapped.sum() > 20, "the last walk must go where no other went"
    off = np.sqrt(((update.grid_map.mean - whole.mean)[:, mapped] ** 2).mean())
    off_before = np.sqrt(((before.grid_map.mean - whole.mean)[:, mapped] ** 2).mean())
    assert off < 0.5 * off_before


def test_taking_a_walk_out_again_gives_the_map_back(
    before: MapBuild, update: MapUpdate, walks: list[SurveyWalk]
) -> None:
    back = update_map(
        update.grid_map, update.evidence, MapModel.from_values(before.model), removed=[walks[-1].walk_id]
    ).grid_map
    np.testing.assert_allclose(back.mean, before.grid_map.mean, atol=1e-3)
    np.testing.assert_allclose(back.sd, before.grid_map.sd, atol=1e-3)
    np.testing.assert_allclose(back.support, before.grid_map.support, atol=1e-4)


def test_sources_name_who_brought_the_walk(update: MapUpdate, walks: list[SurveyWalk]) -> None:
    (source,) = (s for s in update.evidence.sources if s.id == walks[-1].walk_id)
    assert (source.kind, source.contributor, source.device) == (SourceKind.SURVEY, "key_1", "dev_1")
    assert source.t == pytest.approx(walks[-1].samples.t[0], abs=10.0)


def test_the_survey_lines_of_the_walk_are_kept(before: MapBuild, update: MapUpdate) -> None:
    assert before.grid_map.routes is not None
    assert update.grid_map.routes is not None
    assert len(update.grid_map.routes.first) == len(before.grid_map.routes.first) + 1


def test_a_walk_beyond_the_map_makes_it_grow_by_whole_squares(before: MapBuild, walks: list[SurveyWalk]) -> None:
    far = walks[-1]
    moved = replace(
        far,
        walk_id="far",
        waypoints=replace(far.waypoints, x=far.waypoints.x - 60.0, y=far.waypoints.y + 20.0),
    )
    grown = updated(before, walks=[NewWalk(moved)]).grid_map
    old = before.grid_map
    assert (old.x0 - grown.x0) / old.cell_m % 64 == 0
    assert grown.x0 < old.x0
    assert grown.extent[3] > old.extent[3]
    c = round((old.x0 - grown.x0) / old.cell_m)
    r = round((old.y0 - grown.y0) / old.cell_m)
    rows, columns = old.shape
    np.testing.assert_allclose(grown.support[r : r + rows, c : c + columns], old.support, atol=30.0)
    assert grown.mapped.sum() > old.mapped.sum() + 50


def test_rows_of_a_session_count_for_less_the_less_their_place_is_known(before: MapBuild) -> None:
    at = before.evidence.xy[:30].astype(float) + np.array([0.0, 6.0])
    values = before.evidence.values[:30].astype(float) + 8.0
    source = EvidenceSource("ctr_1", SourceKind.SESSION, contributor="key_2", t=1.0)
    sharp, vague = (
        updated(before, contributed=Evidence.of(FeatureSet.VECTOR, source, at, values, spread)).grid_map
        for spread in (0.0, 3.0)
    )
    r = np.rint((at[:, 1] - sharp.y0) / sharp.cell_m).astype(int)
    c = np.rint((at[:, 0] - sharp.x0) / sharp.cell_m).astype(int)
    assert sharp.sd[2, r, c].mean() < vague.sd[2, r, c].mean() < before.grid_map.sd[2, r, c].mean()


def test_rows_of_no_weight_are_kept_and_do_nothing(before: MapBuild) -> None:
    at = before.evidence.xy[:30].astype(float)
    source = EvidenceSource("ctr_1", SourceKind.SESSION, t=1.0)
    rows = Evidence.of(FeatureSet.VECTOR, source, at, before.evidence.values[:30].astype(float) + 30.0)

    def distrust(evidence: Evidence) -> Evidence:
        session = np.array([s.kind is SourceKind.SESSION for s in evidence.sources])[evidence.source]
        return replace(evidence, weight=np.where(session, 0.0, evidence.weight).astype(np.float32))

    update = updated(before, contributed=rows, weigh=distrust)
    assert len(update.evidence) == len(before.evidence) + 30
    np.testing.assert_allclose(update.grid_map.mean, before.grid_map.mean, atol=1e-3)


def test_a_walk_that_cannot_be_placed_is_reported_and_changes_nothing(
    before: MapBuild, walks: list[SurveyWalk]
) -> None:
    bad = replace(walks[0], walk_id="bad", waypoints=replace(walks[0].waypoints, t=walks[0].waypoints.t + 1e6))
    update = updated(before, walks=[NewWalk(bad)])
    (report,) = update.walks
    assert report.rejected
    assert not update.changed.any()


def test_only_vector_maps_are_updated(walks: list[SurveyWalk]) -> None:
    build = build_map("lvl", walks[:5], MapBuildSettings(features=FeatureSet.HV))
    with pytest.raises(MapError, match="build it anew"):
        updated(build, walks=[NewWalk(walks[-1])])


def test_what_is_given_is_not_touched(before: MapBuild, walks: list[SurveyWalk]) -> None:
    copy = before.grid_map.mean.copy(), before.evidence.weight.copy()
    updated(before, walks=[NewWalk(walks[-1])])
    np.testing.assert_array_equal(before.grid_map.mean, copy[0])
    np.testing.assert_array_equal(before.evidence.weight, copy[1])


def as_session(evidence: Evidence, name: str) -> Evidence:
    """The same rows from a session."""
    source = EvidenceSource(name, SourceKind.SESSION, contributor=name, t=1.0)
    return Evidence.of(FeatureSet.VECTOR, source, evidence.xy.astype(float), evidence.values.astype(float))


def test_surveys_overtaken_by_a_change_count_again_when_what_told_of_it_is_gone(before: MapBuild) -> None:
    def overtaken(evidence: Evidence) -> Evidence:
        """Sessions tell of a change that makes all surveys history; without sessions there is none."""
        session = np.array([s.kind is SourceKind.SESSION for s in evidence.sources])[evidence.source]
        weight = np.where(session, 1.0, 0.0) if session.any() else np.ones(len(evidence))
        return replace(evidence, weight=weight.astype(np.float32))

    fraud = updated(before, contributed=as_session(before.evidence.subset(np.arange(30)), "ctr_1"), weigh=overtaken)
    assert (fraud.evidence.weight == 0.0).any()
    back = update_map(
        fraud.grid_map, fraud.evidence, MapModel.from_values(before.model), removed=["ctr_1"], weigh=overtaken
    )
    assert (back.evidence.weight > 0.0).all()


def test_rows_of_a_copied_walk_are_told_from_the_walk_that_was_copied(before: MapBuild) -> None:
    source = before.evidence.sources[0]
    own = before.evidence.subset(before.evidence.source == 0)
    own = replace(own, weight=np.ones(len(own), np.float32))
    model = MapModel.from_values(before.model)
    base = update_map(before.grid_map, before.evidence.without([source.id]), model, contributed=as_session(own, "a"))
    copied = update_map(base.grid_map, base.evidence, model, contributed=as_session(own, "b"))
    assert copied.changed.any()
    assert update_map(copied.grid_map, copied.evidence, model, removed=["b"]).changed.any()


def test_a_map_that_loses_all_its_sources_knows_nothing(before: MapBuild) -> None:
    update = updated(before, removed=[source.id for source in before.evidence.sources])
    assert not len(update.evidence)
    assert not update.grid_map.mapped.any()
    assert np.isfinite(update.grid_map.mean).all()


def test_a_walk_far_off_the_level_is_reported_and_stops_nothing(before: MapBuild, walks: list[SurveyWalk]) -> None:
    far = replace(walks[0], walk_id="far", waypoints=replace(walks[0].waypoints, x=walks[0].waypoints.x + 1e6))
    update = updated(before, walks=[NewWalk(far), NewWalk(walks[-1])])
    lost, found = update.walks
    assert lost.rejected is not None
    assert "of this level" in lost.rejected
    assert found.rejected is None
    assert update.grid_map.shape == before.grid_map.shape
    assert update.changed.any()
