"""The evaluation's view of a running service, over the Python client."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import isodyn_client as isodyn

from app.cli.convert import aids_of, ble_of, fixes_from, prior_of, samples_of, waypoints_of, wifi_of
from app.engine.types import Fix, MapBuildSettings, Prior, Progress, Segment, SurveyWalk
from app.evaluation.drivers import FieldRaster, LevelUpload
from app.evaluation.errors import TransportError

if TYPE_CHECKING:
    from isodyn_client import Client

WAIT_S = 30.0
"""How long the service may hold the answer to a segment."""
SURVEY_NAME = "train walks"
BUILD_TIMEOUT_S = 1800.0


@dataclass
class ServiceTransport:
    """A service as :class:`app.evaluation.drivers.Transport`; safe to use from several threads."""

    client: Client
    wait_s: float = WAIT_S
    _venues: dict[str, str] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add_level(self, level: LevelUpload) -> str:
        """Create the level (and its venue, once per site) with its plans; returns the level's id."""
        with _translated(), self._lock:
            if level.site not in self._venues:
                self._venues[level.site] = self.client.create_venue(level.site).id
            created = self.client.create_level(
                self._venues[level.site], level.name, ordinal=level.ordinal, extent=level.extent
            )
            if level.plan_png is not None:
                self.client.set_plan_image(created.id, level.plan_png)
            if level.vector_plan is not None:
                self.client.set_vector_plan(created.id, json.dumps(level.vector_plan).encode())
            return created.id

    def add_walks(self, level_id: str, walks: Sequence[SurveyWalk], progress: Progress) -> None:
        """Upload survey walks into a new survey of the level."""
        with _translated():
            survey = self.client.create_survey(level_id, SURVEY_NAME)
            for number, walk in enumerate(walks, start=1):
                add_walk(self.client, survey.id, walk)
                progress(number / len(walks), f"walk {number} of {len(walks)}")

    def build_map(self, level_id: str, settings: MapBuildSettings, progress: Progress) -> None:
        """Build the level's map and wait for it."""
        with _translated():
            build_map(self.client, level_id, settings, progress)

    def field_raster(self, level_id: str) -> FieldRaster | None:
        """Magnitude of the level's current map."""
        with _translated():
            level = self.client.level(level_id)
            return None if level.current_map_id is None else magnitude(self.client, level.current_map_id)

    def venue_of(self, level_id: str) -> str:
        """Id of the venue that a level is of."""
        with _translated():
            return self.client.level(level_id).venue_id

    def open_session(self, prior: Prior, venue_id: str, *, method: str, parameters: Mapping[str, object]) -> str:
        """Open a session on ``prior.level_id``, or anywhere in the venue if the prior names no level."""
        with _translated():
            info = self.client.create_session(
                prior.level_id,
                venue_id=venue_id if prior.level_id is None else None,
                method=method or None,
                parameters=dict(parameters) or None,
                prior=prior_of(prior),
            )
            return info.id

    def locate(
        self, prior: Prior, venue_id: str, segment: Segment, *, method: str, parameters: Mapping[str, object]
    ) -> Sequence[Fix]:
        """Locate a segment at once."""
        with _translated():
            answer = self.client.locate(
                prior.level_id,
                samples_of(segment.samples),
                venue_id=venue_id if prior.level_id is None else None,
                method=method or None,
                parameters=dict(parameters) or None,
                prior=prior_of(prior),
                aids=aids_of(segment),
            )
        return fixes_from(answer.fixes)

    def send_segment(self, session_id: str, seq: int, segment: Segment) -> Sequence[Fix]:
        """Send one segment and wait for its fixes."""
        with _translated():
            sent = self.client.send_segment(
                session_id, seq, samples_of(segment.samples), aids=aids_of(segment), wait=self.wait_s
            )
            if not sent.state.final:
                sent = self.client.wait_for_segment(session_id, seq)
        if sent.fixes is None:
            raise TransportError(sent.error or f"the segment was {sent.state}", accepted=True)
        return fixes_from(sent.fixes)

    def close_session(self, session_id: str) -> None:
        """Close the session."""
        with _translated():
            self.client.close_session(session_id)


def add_walk(client: Client, survey_id: str, walk: SurveyWalk) -> isodyn.Walk:
    """Upload one survey walk."""
    return client.add_walk(
        survey_id,
        walk.walk_id,
        samples_of(walk.samples),
        waypoints_of(walk.waypoints),
        wifi=wifi_of(walk.wifi),
        ble=ble_of(walk.ble),
    )


def build_map(client: Client, level_id: str, settings: MapBuildSettings, progress: Progress) -> isodyn.MapInfo:
    """Build a map and tell how far it is."""
    return client.build_map(
        level_id,
        features=settings.features.value,
        cell_m=settings.cell_m,
        mapped_m=settings.mapped_m,
        align=settings.align,
        timeout=BUILD_TIMEOUT_S,
        progress=lambda job: progress(job.progress, job.progress_text),
    )


def magnitude(client: Client, map_id: str) -> FieldRaster:
    """Magnitude of a map's field, NaN where there is no map."""
    field = client.map_field(map_id, "total")
    return FieldRaster(field.x0, field.y0, field.cell_m, field.values)


@contextmanager
def _translated() -> Iterator[None]:
    try:
        yield
    except isodyn.IsodynError as error:
        raise TransportError(str(error)) from error
