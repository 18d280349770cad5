"""Survey planning over stored maps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.suggestions import Reason
from app.engine.types import Evidence, EvidenceSource, GridMap, SourceKind
from app.services import planning
from app.services.errors import InvalidError, NoEvidenceError, NotFoundError
from app.services.planning import HEADING_LAYERS, PlanningService, QualityLayer
from app.services.records import Anchor
from tests.support.builders import World, grid_map


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """One database for all: planning stores nothing."""
    made = World.at(tmp_path_factory.mktemp("planning"))
    yield made
    made.close()


def _map_id(world: World) -> str:
    map_id = world.mapped_level().current_map_id
    assert map_id is not None
    return map_id


class WithEvidence:
    """The map service of a world, whose maps rest on two walks that disagree east of x = 20 m."""

    def __init__(self, world: World, t: float) -> None:
        self._maps = world.services.maps
        self.get, self.grid = self._maps.get, self._maps.grid
        self.t = t

    def evidence(self, map_id: str) -> Evidence:
        grid = self.grid(map_id)
        x = np.arange(0.0, 60.0, 0.25)
        xy = np.stack([x, np.full(len(x), 12.0)], axis=1)
        values = np.full((len(x), len(grid.features.channels)), 20.0)
        rng = np.random.default_rng(0)
        walks = [values + rng.normal(0, 1.0, values.shape) + 20.0 * k * (x > 20)[:, None] for k in (0, 1)]
        return Evidence.joined(
            [
                Evidence.of(grid.features, EvidenceSource(f"w{k}", SourceKind.SURVEY, t=self.t), xy, v)
                for k, v in enumerate(walks)
            ]
        )


def _with_evidence(world: World, t: float = 0.0) -> PlanningService:
    return PlanningService(uow=world.database, clock=world.clock, maps=WithEvidence(world, t))  # type: ignore[arg-type]


def test_quality_of_a_map(world: World) -> None:
    map_id = _map_id(world)
    found = world.services.planning.quality(map_id)
    assert found.info.id == map_id
    assert found.coverage.mapped_share == pytest.approx(69 / 70)
    assert found.mean_error.p50_m is not None
    assert found.worst_error.p50_m is not None
    assert 0 < found.mean_error.p50_m <= found.worst_error.p50_m
    assert [deg for deg, _ in found.by_heading] == [0, 45, 90, 135, 180, 225, 270, 315]
    assert found.conflict is not None
    assert found.conflict.shared_cells == 0


def test_a_map_with_nothing_mapped_has_no_error(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = replace(grid_map(), support=np.full((70, 130), 8.0, np.float32))
    monkeypatch.setattr(type(world.services.maps), "grid", lambda self, map_id: bare)
    found = world.services.planning.quality(_map_id(world))
    assert (found.mean_error.p50_m, found.worst_error.p90_m) == (None, None)
    assert world.services.planning.suggestions(found.info.id, 3).plan.suggestions == ()


@pytest.mark.parametrize("layer", [QualityLayer.MEAN_ERROR, QualityLayer.WORST_ERROR, *sorted(HEADING_LAYERS)])
def test_error_layers_lie_on_mapped_nodes(world: World, layer: QualityLayer) -> None:
    heading = 90 if layer in HEADING_LAYERS else None
    raster = world.services.planning.raster(_map_id(world), layer, heading)
    # the last row of the map is not mapped, and is cut off
    assert raster.values.shape == (69, 130)
    assert np.isfinite(raster.values).all()
    assert (raster.x0, raster.cell_m) == (grid_map().x0, grid_map().cell_m)


def test_coverage_layer(world: World) -> None:
    raster = world.services.planning.raster(_map_id(world), QualityLayer.COVERAGE)
    assert raster.values.shape == (70, 130)
    assert set(raster.values[:-1].ravel()) == {1.0}
    assert set(raster.values[-1]) == {0.0}


def test_a_heading_is_named_where_it_means_something(world: World) -> None:
    map_id = _map_id(world)
    for layer, heading in [
        (QualityLayer.ALONG, None), (QualityLayer.ALONG, 30), (QualityLayer.COVERAGE, 90),
    ]:  # fmt: skip
        with pytest.raises(InvalidError) as caught:
            world.services.planning.raster(map_id, layer, heading)
        assert caught.value.field == "heading_deg"


def test_a_forecast_of_a_map_is_computed_once(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    compute = planning.forecast_accuracy

    def counted(grid: GridMap) -> planning.AccuracyForecast:
        calls.append(grid)
        return compute(grid)

    monkeypatch.setattr(planning, "forecast_accuracy", counted)
    map_id = _map_id(world)
    world.services.planning.quality(map_id)
    world.services.planning.raster(map_id, QualityLayer.MEAN_ERROR)
    assert len(calls) == 1


def test_age_is_that_of_the_newest_evidence_when_the_map_was_made(world: World) -> None:
    map_id = _map_id(world)
    made = world.services.maps.get(map_id).created_at.timestamp()
    raster = _with_evidence(world, made - 3.0 * 86_400.0).raster(map_id, QualityLayer.AGE)
    known = np.isfinite(raster.values)
    assert 30 < known.sum() < 100  # a line of some 60 m, in cells of a metre
    np.testing.assert_allclose(raster.values[known], 3.0, rtol=1e-5)


@pytest.mark.parametrize("layer", [QualityLayer.CONFLICT, QualityLayer.SOURCES, QualityLayer.AGE])
def test_maps_without_evidence_cannot_tell_conflicts(
    world: World, layer: QualityLayer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(world.services.maps), "evidence", lambda self, map_id: None)
    with pytest.raises(NoEvidenceError, match="POST /v1/maps"):
        world.services.planning.raster(_map_id(world), layer)


def test_conflicts_of_a_map_with_evidence(world: World) -> None:
    map_id, service = _map_id(world), _with_evidence(world)
    found = service.quality(map_id).conflict
    assert found is not None
    assert found.shared_cells == pytest.approx(60, abs=2)
    ratio, sources = service.raster(map_id, QualityLayer.CONFLICT), service.raster(map_id, QualityLayer.SOURCES)
    # nodes of the raster are the middles of its cells, which begin half a node's distance before the map's first
    assert (ratio.x0, ratio.y0) == (grid_map().x0 - 0.25 + 0.5, grid_map().y0 - 0.25 + 0.5)
    row = round((12.0 - ratio.y0) / ratio.cell_m)
    assert np.nanmax(sources.values) == 2.0
    assert np.isfinite(ratio.values).sum() == found.shared_cells
    assert np.isfinite(ratio.values[row]).sum() == found.shared_cells


def test_suggestions_of_a_map(world: World) -> None:
    map_id = _map_id(world)
    found = world.services.planning.suggestions(map_id, 4)
    assert len(found.plan.suggestions) == 4
    assert found.anchor is None
    world.services.venues.update(found.venue_id, "House", Anchor(48.1, 11.5))
    assert world.services.planning.suggestions(map_id, 1).anchor == Anchor(48.1, 11.5)


def test_old_walks_are_walked_again(world: World) -> None:
    map_id = _map_id(world)
    now = world.clock.now.timestamp()
    old = _with_evidence(world, now - 800 * 86400.0).suggestions(map_id, 3)
    fresh = _with_evidence(world, now - 8 * 86400.0).suggestions(map_id, 3)
    assert any(Reason.OLD in one.reasons for one in old.plan.suggestions)
    assert old.plan.suggestions != fresh.plan.suggestions or not any(
        Reason.OLD in one.reasons for one in fresh.plan.suggestions
    )


def test_a_route(world: World) -> None:
    map_id = _map_id(world)
    outlook = world.services.planning.forecast(map_id, [(0.0, 5.0), (20.0, 5.0)], 3.0)
    assert outlook.forecast.way[-1] == pytest.approx(20.0)
    closer = world.services.planning.forecast(map_id, [(0.0, 5.0), (20.0, 5.0)], 0.2)
    assert closer.forecast.error[0] < outlook.forecast.error[0]
    for route in ([(0.0, 5.0), (0.0, 5.0)], [(0.0, 0.0), (0.0, 2001.0)]):
        with pytest.raises(InvalidError) as caught:
            world.services.planning.forecast(map_id, route, 3.0)
        assert caught.value.field == "route"


def test_no_such_map(world: World) -> None:
    service = world.services.planning
    for ask in (
        lambda: service.quality("map_0"),
        lambda: service.raster("map_0", QualityLayer.COVERAGE),
        lambda: service.suggestions("map_0", 1),
        lambda: service.forecast("map_0", [(0.0, 0.0), (1.0, 1.0)], 3.0),
        lambda: world.services.maps.evidence("map_0"),
    ):
        with pytest.raises(NotFoundError):
            ask()
