"""Scores of maps: prediction along walks that they have not seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli.root import app
from app.engine.mapping.offsets import rotate_horizontal
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import Evidence, EvidenceSource, FeatureSet, Float64Array, GridMap, MapBuild, SourceKind
from app.evaluation import field
from app.evaluation.field import CellMeans, FieldReport, FieldScores, predicted, score_walks
from tests.support.walks import Field

FIELD = Field.random(np.random.default_rng(3))
SD, NOISE = 1.5, 2.0


def _walk(rng: np.random.Generator, *, error: float = 0.0) -> PlacedSamples:
    """Two legs through the hall; the phone has a hard iron, and readings err by ``error``."""
    s = np.arange(0.0, 18.0, 0.3)
    start = rng.uniform(1.0, 2.0, 2)
    xy = np.concatenate([start + np.outer(s, [1.0, 0.0]), start + np.array([18.0, 0.0]) + np.outer(s, [0.0, 0.5])])
    heading = np.repeat([0.0, np.pi / 2], len(s))
    field = FIELD.at(xy) + error * rng.standard_normal((len(xy), 3))
    mag = rotate_horizontal(field, -heading) + rng.normal(0.0, 3.0, 3)
    return PlacedSamples("walk", np.arange(float(len(xy))), xy, heading, mag)


def _build(survey: list[PlacedSamples]) -> MapBuild:
    """A map that is the field plus an error of its claimed deviation."""
    axis = 0.25 * np.arange(100)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    mean = FIELD.at(nodes).T.reshape(3, 100, 100)
    grid = GridMap(
        "lvl", FeatureSet.VECTOR, 0.0, 0.0, 0.25, mean.astype(np.float32), np.full(mean.shape, SD, np.float32),
        np.zeros((100, 100), np.float32), 1.5, (NOISE,) * 3,
    )  # fmt: skip
    source = EvidenceSource("a", SourceKind.SURVEY)
    xy = np.concatenate([walk.xy for walk in survey])
    evidence = Evidence.of(FeatureSet.VECTOR, source, xy, np.zeros((len(xy), 3)))
    return MapBuild(grid, (), len(xy), 5.0, (5.0,) * 3, evidence, {})


def test_a_true_claim_has_variance_one() -> None:
    rng = np.random.default_rng(1)
    survey = [_walk(rng) for _ in range(5)]
    # readings that err by as much as map and reading are claimed to together
    asked = [_walk(rng, error=float(np.hypot(SD, NOISE))) for _ in range(20)]
    scores = score_walks("lvl", _build(survey), survey, asked)
    values = scores.values()
    assert values["normalized_variance"]["all"] == pytest.approx(1.0, abs=0.08)
    assert values["n"] == len(scores.baseline) > 500
    doubled = score_walks("lvl", _build(survey), survey, [_walk(rng, error=5.0) for _ in range(20)])
    assert doubled.values()["normalized_variance"]["all"] == pytest.approx(4.0, rel=0.12)


def test_a_perfect_map_beats_cell_means() -> None:
    rng = np.random.default_rng(2)
    survey, asked = [_walk(rng) for _ in range(5)], [_walk(rng) for _ in range(4)]
    values = score_walks("lvl", _build(survey), survey, asked).values()
    assert values["rms_vertical"] < 0.2
    assert values["rms_vertical"] < 0.5 * values["baseline_vertical"]
    # a hard iron of the walk is not a mean of its horizontal magnitude, so some of it stays for both
    assert values["rms_horizontal"] < values["baseline_horizontal"]


def test_walks_far_from_the_survey_are_not_scored() -> None:
    rng = np.random.default_rng(3)
    survey = [_walk(rng)]
    far = replace(survey[0], xy=survey[0].xy + 200.0)
    values = score_walks("lvl", _build(survey), survey, [far]).values()
    assert values["n"] == 0
    assert values["rms_vertical"] is None
    assert values["by_distance"][0] == {
        "from_m": 0.0, "to_m": 0.5, "n": 0, "all": None, "x": None, "y": None, "z": None,
    }  # fmt: skip


def test_cell_means_are_means_of_cells() -> None:
    xy = np.array([[0.1, 0.1], [0.4, 0.3], [-0.1, 0.1]])
    mag = np.array([[3.0, 4.0, 1.0], [0.0, 5.0, 3.0], [6.0, 8.0, 7.0]])
    cells = CellMeans.of([PlacedSamples("a", np.arange(3.0), xy, np.zeros(3), mag)])
    found = cells.at(np.array([[0.2, 0.2], [-0.4, 0.4], [5.0, 5.0]]))
    np.testing.assert_allclose(found[:2], [[2.0, 5.0], [7.0, 10.0]])
    assert np.isnan(found[2]).all()


def test_prediction_is_bilinear() -> None:
    build = _build([_walk(np.random.default_rng(4))])
    mean, sd = predicted(build.grid_map, np.array([[1.0, 2.0], [1.125, 2.0]]))
    grid = build.grid_map.mean
    np.testing.assert_allclose(mean[0], grid[:, 8, 4], rtol=1e-6)
    np.testing.assert_allclose(mean[1], 0.5 * (grid[:, 8, 4] + grid[:, 8, 5]), rtol=1e-6)
    np.testing.assert_allclose(sd, SD)


def _scores(name: str, residual: Float64Array) -> FieldScores:
    return FieldScores(name, residual, 2.0 * residual, np.ones((4, 3)), np.array([0.1, 0.7, 1.5, 3.0]))


def test_levels_are_pooled_in_the_report() -> None:
    report = FieldReport((_scores("a", np.ones((3, 2))), _scores("b", 3.0 * np.ones((1, 2)))))
    content = json.loads(report.to_json())
    assert content["levels"].keys() == {"a", "b"}
    assert content["overall"]["n"] == 4
    assert content["overall"]["rms_vertical"] == pytest.approx(np.sqrt(12.0 / 4.0))
    table = report.table().splitlines()
    assert table[-1].split()[:4] == ["all", "4", "3.46", "1.73"]


def test_the_command_prints_and_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(field, "score_level", lambda level: _scores(level.name, np.ones((2, 2))))
    report = tmp_path / "field.json"
    options = ["--data", "maps/samples", "--levels", "site1-F2", "--json", str(report)]
    result = CliRunner().invoke(app, ["evaluate", "field", *options])
    assert result.exit_code == 0, result.output
    assert json.loads(report.read_text())["levels"].keys() == {"site1-F2"}
    assert "Bv base" in result.output


def test_a_level_that_is_not_there_is_refused() -> None:
    result = CliRunner().invoke(app, ["evaluate", "field", "--data", "maps/samples", "--levels", "site9-F9"])
    assert result.exit_code != 0
