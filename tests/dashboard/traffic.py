"""Traffic for pages that show it: walks of the sample floor as sessions, with known positions."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from isodyn_client import Client, Prior

from app.cli.convert import samples_of, to_ms
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.dashboard.floors import Floor
from tests.e2e.service import Service


def walk_sessions(service: Service, floor: Floor, level: Ilc20Level, n: int) -> list[str]:
    """So many walks as open sessions of a device, each with its waypoints as ground truth; their ids."""
    ids = []
    with Client(f"http://127.0.0.1:{service.port}", service.key) as client:
        device = client.create_device("trolley")
        for walk in level.walks("train")[:n]:
            marks = walk.waypoints
            prior = Prior(x=float(marks.x[0]), y=float(marks.y[0]), radius_m=3.0)
            session = client.open_session(floor.level_id, prior=prior, device_id=device.id)
            samples = samples_of(walk.samples)
            # as if it were walked just now: statistics look at the last days
            later = np.round(1000.0 * time.time() - samples.t_ms[-1]) - 1000.0
            for _ in session.send_all(replace(samples, t_ms=samples.t_ms + later), wait=30.0):
                pass
            client.add_ground_truth(
                session.id, to_ms(marks.t) + later, marks.x, marks.y, sd_m=np.full(len(marks.x), 0.5)
            )
            ids.append(session.id)
    return ids
