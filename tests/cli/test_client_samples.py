"""Raw samples and profiles through the Python client, on the real service."""

from __future__ import annotations

import io

import isodyn_client as isodyn
import msgpack
import numpy as np
import pytest

from app.cli.convert import samples_of
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.cli.conftest import SAMPLE, Service, Surveyed


def test_the_profile_agrees_with_the_map(service: Service, surveyed: Surveyed) -> None:
    """A walk of the survey itself: what it measures is what the map says, within what the two may differ by."""
    walk = Ilc20Level("site1-F2", SAMPLE).walks("train")[0]
    samples = samples_of(walk.samples)
    with service.client() as client:
        prior = isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]))
        with client.open_session(surveyed.level_id, prior=prior, parameters={"particles": 500}) as session:
            for _ in session.send_all(samples, wait=20):
                pass
        profile = client.measured_profile(session.id)
        parts = list(msgpack.Unpacker(io.BytesIO(client.session_samples(session.id, format="msgpack"))))
        lines = client.session_samples(session.id, last=0).splitlines()
    t_ms = np.concatenate([np.frombuffer(part["samples"]["t_ms"], "<f8") for part in parts])
    assert t_ms == pytest.approx(samples.t_ms)
    assert len(lines) == 1 + len(parts[0]["samples"]["t_ms"]) // 8
    assert len(profile.number) > 20
    columns = [np.array(getattr(profile, name).total, dtype=float) for name in ("measured", "mapped", "sd")]
    measured, mapped, sd = columns
    known = np.isfinite(measured) & np.isfinite(mapped)
    assert known.mean() > 0.5
    assert np.median(abs(measured - mapped)[known] / sd[known]) < 3.0
