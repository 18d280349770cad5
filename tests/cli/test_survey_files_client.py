"""Files of survey recordings through the Python client."""

from __future__ import annotations

import isodyn_client as isodyn
import pytest

from tests.cli.conftest import Service
from tests.exchange.recordings import WALK, csv_of


def test_a_file_is_tried_then_read(service: Service) -> None:
    with service.client() as client:
        venue = client.create_venue("Files")
        level = client.create_level(venue.id, "1", extent=isodyn.Extent(x_min=-5, y_min=-5, x_max=60, y_max=40))
        survey = client.create_survey(level.id, "files")
        content = csv_of(factors={"mag": 1000.0})
        tried = client.import_survey(survey.id, content, format="csv", unit={"mag": "nT", "acc": "m/s^2"}, dry_run=True)
        assert (tried.dry_run, [walk.fate for walk in tried.walks]) == (True, ["new"])
        assert client.survey(survey.id).n_walks == 0
        done = client.import_survey(survey.id, content, format="csv", name="hall", unit={"mag": "nT"})
        (walk,) = done.walks
        assert (walk.name, walk.n_samples) == ("hall", len(WALK.samples))
        (track,) = client.waypoints(level.id, survey_id=survey.id)
        assert track.walk_id == walk.walk_id
        assert track.x == pytest.approx(walk.x, abs=1e-3)
        with pytest.raises(isodyn.InvalidRequestError):
            client.import_survey(survey.id, b"nothing", format="archive")
