"""Versions of maps and replays, through the command line and the client, against a real service."""

from __future__ import annotations

import json
from pathlib import Path

import isodyn_client as isodyn
import numpy as np
import pytest
from PIL import Image

from app.cli.convert import samples_of
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.cli.conftest import SAMPLE, Service, Surveyed, run


@pytest.fixture(scope="module")
def draft(service: Service, surveyed: Surveyed) -> str:
    """A version of the surveyed level in other features."""
    with service.client() as client:
        client.publish_map(surveyed.level_id, surveyed.map_id)  # other commands may have published their own since
    options = ("--cell", "1", "--features", "hv", "--draft")
    return service.isodyn("map", "build", surveyed.level_id, *options).stdout.strip()


@pytest.fixture(scope="module")
def session_id(service: Service, surveyed: Surveyed) -> str:
    """A session on the version that is published."""
    walk = next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))
    start = isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]), heading_deg=10.0)
    with service.client() as client, client.open_session(surveyed.level_id, prior=start) as session:
        list(session.send_all(samples_of(walk.samples)[:1500], wait=20))
        return session.id


def test_a_version_is_published_and_rolled_back(service: Service, surveyed: Surveyed, draft: str) -> None:
    level_id = surveyed.level_id
    with service.client() as client:
        assert client.level(level_id).current_map_id == surveyed.map_id
        said = service.isodyn("map", "publish", draft, "--note", "a try").stdout
        assert f"{draft} is published on {level_id}, in place of {surveyed.map_id}" in said
        assert client.level(level_id).current_map_id == draft
        for _ in client.maps(level_id=level_id):
            service.isodyn("map", "rollback", level_id)
            if client.level(level_id).current_map_id == surveyed.map_id:
                break
        assert client.level(level_id).current_map_id == surveyed.map_id
        notes = [one.note for one in client.publications(level_id)]
    assert (notes[0], notes[-1]) == ("rolled back", "built")
    assert "a try" in notes
    shown = service.isodyn("map", "history", level_id).stdout
    assert all(word in shown for word in (*notes, draft, surveyed.map_id))
    too_far = run("map", "rollback", level_id, ISODYN_URL=service.url, ISODYN_KEY=service.key)
    assert too_far.exit_code == 1
    assert "no older version" in too_far.output


def test_a_difference_is_shown_and_drawn(service: Service, surveyed: Surveyed, draft: str, tmp_path: Path) -> None:
    image = tmp_path / "change.png"
    shown = service.isodyn("map", "diff", draft, "--image", image, "--statistic", "significance").stdout
    assert surveyed.map_id in shown
    assert "features vector -> hv" in shown
    with service.client() as client:
        found, info = client.map_diff(draft), client.map_info(draft)
        change = client.map_change(draft, component="v")
        back = client.map_diff(surveyed.map_id, against=draft, least_ut=0.0)
        new, old = ({one.id for one in client.map_sources(map_id)} for map_id in (draft, surveyed.map_id))
    assert (found.against, found.features) == (surveyed.map_id, isodyn.FeatureSet.HV)
    assert found.sources.n_added == len(new - old)
    assert np.isfinite(change.values).sum() == found.compared.nodes == back.compared.nodes > 0
    assert [one.component for one in found.change] == ["all", "h", "v", "total"]
    assert found.change[0].rms == pytest.approx(back.change[0].rms)
    with Image.open(image) as drawn:
        assert drawn.size == (info.columns, info.rows)


def test_sources_are_listed(service: Service, surveyed: Surveyed) -> None:
    with service.client() as client:
        found = list(client.map_sources(surveyed.map_id))
        walks = {walk.id for walk in client.walks(surveyed.survey_id)}
        info = client.map_info(surveyed.map_id)
    assert {one.id for one in found} == walks
    assert {one.survey_id for one in found} == {surveyed.survey_id}
    assert sum(one.n_samples or 0 for one in found) == info.n_samples
    assert all(one.id in service.isodyn("map", "sources", surveyed.map_id).stdout for one in found)


def test_a_session_is_replayed(
    service: Service, surveyed: Surveyed, draft: str, session_id: str, tmp_path: Path
) -> None:
    with service.client() as client:
        same, told = client.replay(session_id), client.positions(session_id)
        other = client.replay(session_id, map_id=draft)
    assert same.maps == same.maps_then
    np.testing.assert_array_equal(same.fixes.x, told.x)
    assert same.comparison.distance is not None
    assert (same.comparison.distance.largest, same.comparison.n_compared) == (0.0, len(told))
    assert other.comparison.distance is not None
    assert other.comparison.distance.largest > 0.0
    file = tmp_path / "replay.json"
    shown = service.isodyn("session", "replay", session_id, "--map", draft, "--json", file).stdout
    assert "apart, all" in shown
    assert (draft in shown, surveyed.map_id in shown) == (True, True)
    written = json.loads(file.read_text())
    assert written["comparison"]["distance"]["largest"] == other.comparison.distance.largest
    assert len(written["fixes"]["x"]) == len(other.fixes)


def test_a_session_is_opened_on_a_draft(service: Service, surveyed: Surveyed, draft: str) -> None:
    with service.client() as client:
        venue_id = client.level(surveyed.level_id).venue_id
        for place in ({"level_id": surveyed.level_id}, {"venue_id": venue_id}):
            session = client.create_session(**place, map_ids=[draft])
            assert [one.map_id for one in session.maps] == [draft]
