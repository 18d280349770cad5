"""The synchronous client."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import httpx

from isodyn_client import endpoints, ingest, live, operations, survey_files, tracks
from isodyn_client import geofences as geofence_calls
from isodyn_client import session_samples as sample_calls
from isodyn_client import webhooks as webhook_calls
from isodyn_client.aids import Aids
from isodyn_client.calls import Call, Listing
from isodyn_client.connection import Connection
from isodyn_client.encoding import Encoding
from isodyn_client.fixes import Fixes
from isodyn_client.flows import Flow, Flows, Pause, Send
from isodyn_client.models import FixKind, Prior, SessionInfo
from isodyn_client.results import SegmentResult
from isodyn_client.retry import RetryPolicy
from isodyn_client.samples import SEGMENT_S, Samples
from isodyn_client.sequence import Sequencer
from isodyn_client.signatures import as_method

P = ParamSpec("P")
T = TypeVar("T")


def _call(build: Callable[P, Call[T]]) -> Callable[Concatenate[Client, P], T]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return self.call(build(*args, **kwargs))

    as_method(build, method)
    return method


def _list(build: Callable[P, Listing[T]]) -> Callable[Concatenate[Client, P], Iterator[T]]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> Iterator[T]:
        return self.iterate(build(*args, **kwargs))

    as_method(build, method)
    return method


def _flow(build: Callable[Concatenate[Flows, P], Flow[T]]) -> Callable[Concatenate[Client, P], T]:
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return self.run(build(self.flows, *args, **kwargs))

    as_method(build, method)
    return method


class Client:
    """A service of Isodyn, called synchronously. Safe to share between threads.

    Parameters
    ----------
    url : str, optional
        Address of the service; without it ``ISODYN_URL``, else ``http://127.0.0.1:8080``.
    key : str, optional
        API key; without it ``ISODYN_KEY``.
    timeout : float, s
        Longest silence that is borne, on top of what ``wait`` asks for.
    retry : RetryPolicy, optional
    transport : httpx.BaseTransport, optional
        For tests: ``httpx.MockTransport``.
    sleep : callable, optional
        For tests: what waits between attempts.

    Examples
    --------
    >>> with Client("https://isodyn.example.org", key="isk_...") as client:   # doctest: +SKIP
    ...     with client.open_session(level_id, prior=Prior(x=3.0, y=4.0)) as session:
    ...         for result in session.send_all(samples, wait=10):
    ...             print(result.position)
    """

    def __init__(
        self,
        url: str | None = None,
        key: str | None = None,
        *,
        timeout: float = 30.0,
        retry: RetryPolicy | None = None,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.connection = Connection.choose(url, key, timeout)
        self.flows = Flows(policy=retry or RetryPolicy())
        self._sleep = sleep
        self._http = httpx.Client(transport=transport, **self.connection.options())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Client({self.connection.url!r})"

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def call(self, call: Call[T]) -> T:
        """Send a call (of :mod:`isodyn_client.endpoints`) and return its result."""
        return self.run(self.flows.exchange(call))

    def iterate(self, listing: Listing[T]) -> Iterator[T]:
        """All items of a list; pages are fetched as they are needed."""
        cursor: str | None = None
        while True:
            page = self.call(listing.page(cursor))
            yield from page.items
            cursor = page.next_cursor
            if cursor is None:
                return

    def run(self, flow: Flow[T]) -> T:
        """Do what a flow asks for until it returns."""
        try:
            step = next(flow)
            while True:
                if isinstance(step, Pause):
                    self._sleep(step.seconds)
                    step = flow.send(None)
                    continue
                try:
                    response = self._send(step)
                except httpx.TransportError as error:
                    step = flow.throw(error)
                else:
                    step = flow.send(response)
        except StopIteration as stop:
            result: T = stop.value
            return result

    def _send(self, step: Send) -> httpx.Response:
        body = step.call.body
        content = body.chunks() if body is not None else None
        return self._http.send(self._http.build_request(content=content, **self.connection.request(step.call)))

    def stream(self, call: Call[Any]) -> AbstractContextManager[httpx.Response]:
        """Send a call once and leave its answer open, to be read as it comes (:mod:`isodyn_client.sse`)."""
        return self._http.stream(**self.connection.request(call))

    def open_session(
        self,
        level_id: str | None = None,
        *,
        venue_id: str | None = None,
        method: str | None = None,
        parameters: Mapping[str, Any] | None = None,
        prior: Prior | None = None,
        device_id: str | None = None,
        map_id: str | None = None,
        map_ids: Sequence[str] | None = None,
        calibration_epoch: str | None = None,
        contribute: bool | None = None,
    ) -> Session:
        """Open a session: one trip of one device, on a level, or with ``venue_id`` instead on any level of a venue.

        Use it in a ``with`` block, which closes it at the end.
        """
        info = self.create_session(
            level_id,
            venue_id=venue_id,
            method=method,
            parameters=parameters,
            prior=prior,
            device_id=device_id,
            map_id=map_id,
            map_ids=map_ids,
            calibration_epoch=calibration_epoch,
            contribute=contribute,
        )
        return Session(self, info)

    def resume_session(self, session_id: str) -> Session:
        """Go on with an open session where it stands."""
        return Session(self, self.session_info(session_id))

    create_venue = _call(endpoints.create_venue)
    venue = _call(endpoints.venue)
    venues = _list(endpoints.venues)
    update_venue = _call(endpoints.update_venue)
    update_level = _call(endpoints.update_level)
    delete_venue = _call(endpoints.delete_venue)
    create_level = _call(endpoints.create_level)
    level = _call(endpoints.level)
    levels = _list(endpoints.levels)
    set_plan_image = _call(endpoints.set_plan_image)
    plan_image = _call(endpoints.plan_image)
    set_vector_plan = _call(endpoints.set_vector_plan)
    vector_plan = _call(endpoints.vector_plan)

    create_device = _call(endpoints.create_device)
    device = _call(endpoints.device)
    devices = _list(endpoints.devices)
    forget_calibrations = _call(endpoints.forget_calibrations)
    device_models = _list(endpoints.device_models)
    device_model = _call(endpoints.device_model)

    create_survey = _call(endpoints.create_survey)
    survey = _call(endpoints.survey)
    surveys = _list(endpoints.surveys)
    add_walk = _call(endpoints.add_walk)
    walk = _call(endpoints.walk)
    walks = _list(endpoints.walks)
    waypoints = _list(endpoints.waypoints)
    delete_walk = _call(endpoints.delete_walk)
    import_survey = _call(survey_files.import_survey)

    request_map = _call(endpoints.request_map)
    build_map = _flow(Flows.build_map)
    update_map = _flow(Flows.update_map)
    map_info = _call(endpoints.map_info)
    publish_map = _call(endpoints.publish_map)
    publications = _list(endpoints.publications)
    map_sources = _list(endpoints.map_sources)
    map_diff = _call(endpoints.map_diff)
    map_change = _call(endpoints.map_change)
    map_change_image = _call(endpoints.map_change_image)
    maps = _list(endpoints.maps)
    map_field = _call(endpoints.map_field)
    map_image = _call(endpoints.map_image)
    map_coverage = _call(endpoints.map_coverage)
    map_quality = _call(endpoints.map_quality)
    quality_raster = _call(endpoints.quality_raster)
    quality_image = _call(endpoints.quality_image)
    survey_suggestions = _call(endpoints.survey_suggestions)
    suggestions_geojson = _call(endpoints.suggestions_geojson)
    forecast_route = _call(endpoints.forecast_route)

    contributions = _list(endpoints.contributions)
    contribution = _call(endpoints.contribution)
    reject_contribution = _call(endpoints.reject_contribution)
    restore_contribution = _call(endpoints.restore_contribution)
    delete_contribution = _call(endpoints.delete_contribution)
    field_changes = _list(endpoints.field_changes)
    export_map = _call(endpoints.export_map)
    import_map = _call(endpoints.import_map)
    export_survey = _call(endpoints.export_survey)

    create_session = _call(endpoints.create_session)
    session_info = _call(endpoints.session_info)
    sessions = _list(endpoints.sessions)
    close_session = _call(endpoints.close_session)
    send_segment = _call(endpoints.send_segment)
    segment = _call(endpoints.segment)
    segments = _list(endpoints.segments)
    wait_for_segment = _flow(Flows.wait_for_segment)
    positions = _flow(Flows.positions)
    positions_geojson = _call(endpoints.positions_geojson)
    trajectory = _call(endpoints.trajectory)
    track = _call(tracks.track)
    session_samples = _call(sample_calls.session_samples)
    measured_profile = _call(sample_calls.measured_profile)
    follow = live.follow
    follow_all = live.follow_all
    replay = _call(endpoints.replay)
    locate = _call(endpoints.locate)

    create_geofence = _call(geofence_calls.create_geofence)
    geofence = _call(geofence_calls.geofence)
    geofences = _list(geofence_calls.geofences)
    update_geofence = _call(geofence_calls.update_geofence)
    delete_geofence = _call(geofence_calls.delete_geofence)
    geofence_events = _list(geofence_calls.geofence_events)
    geofence_events_csv = _call(geofence_calls.geofence_events_csv)

    create_webhook = _call(webhook_calls.create_webhook)
    webhook = _call(webhook_calls.webhook)
    webhooks = _list(webhook_calls.webhooks)
    update_webhook = _call(webhook_calls.update_webhook)
    delete_webhook = _call(webhook_calls.delete_webhook)
    webhook_deliveries = _list(webhook_calls.webhook_deliveries)
    test_webhook = _call(webhook_calls.test_webhook)
    redeliver = _call(webhook_calls.redeliver)

    create_ingest_token = _call(ingest.create_ingest_token)
    ingest_token = _call(ingest.ingest_token)
    ingest_tokens = _list(ingest.ingest_tokens)
    revoke_ingest_token = _call(ingest.revoke_ingest_token)
    phyphox_experiment = _call(ingest.phyphox_experiment)
    recordings = _list(ingest.recordings)
    recording = _call(ingest.recording)
    close_recording = _call(ingest.close_recording)
    set_recording_waypoints = _call(ingest.set_recording_waypoints)
    markers = _call(ingest.markers)
    set_markers = _call(ingest.set_markers)

    job = _call(endpoints.job)
    jobs = _list(endpoints.jobs)
    cancel_job = _call(endpoints.cancel_job)
    wait_for_job = _flow(Flows.wait_for_job)

    methods = _list(endpoints.methods)
    method = _call(endpoints.method)

    create_key = _call(endpoints.create_key)
    key = _call(endpoints.key)
    keys = _list(endpoints.keys)
    current_key = _call(endpoints.current_key)
    revoke_key = _call(endpoints.revoke_key)

    stats = _call(endpoints.stats)
    stats_table = _call(operations.stats_table)
    stats_csv = _call(operations.stats_csv)
    level_stats = _list(operations.level_stats)
    alarms = _call(operations.alarms)
    add_ground_truth = _call(operations.add_ground_truth)
    ground_truth = _list(operations.ground_truth)
    forget_ground_truth = _call(operations.forget_ground_truth)
    ready = _call(endpoints.ready)


class Session:
    """An open session. It numbers its segments itself; use it from one thread at a time.

    Made by :meth:`Client.open_session` and :meth:`Client.resume_session`.
    """

    def __init__(self, client: Client, info: SessionInfo) -> None:
        self.info = info
        self._client = client
        self._sequencer = Sequencer(client.flows, info)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:  # after an error the session stays open, so that it can be resumed
            self.close()

    @property
    def id(self) -> str:
        """Id of the session."""
        return self.info.id

    @property
    def next_seq(self) -> int:
        """Number that the next segment will carry."""
        return self._sequencer.next_seq

    def send(
        self,
        samples: Samples,
        *,
        aids: Aids | None = None,
        wait: float | None = None,
        encoding: Encoding | str = Encoding.MSGPACK,
        gzip: bool = False,
    ) -> SegmentResult:
        """Send the next segment and, with ``wait``, up to that many seconds for its fixes.

        After an error the number is still free: send *the same* samples again, which is safe even if the first
        attempt did arrive.
        """
        return self._client.run(self._sequencer.send(samples, aids=aids, wait=wait, encoding=encoding, gzip=gzip))

    def send_all(
        self,
        samples: Samples,
        *,
        aids: Aids | None = None,
        segment_s: float = SEGMENT_S,
        wait: float | None = None,
    ) -> Iterator[SegmentResult]:
        """Cut samples into segments of ``segment_s`` seconds and send them one after the other."""
        for piece, heard in self._sequencer.pieces(samples, aids, segment_s):
            yield self.send(piece, aids=heard, wait=wait)

    def wait_for(self, seq: int, *, timeout: float = 60.0) -> SegmentResult:
        """Wait until segment ``seq`` is processed."""
        return self._client.wait_for_segment(self.id, seq, timeout=timeout)

    def positions(self, *, seq: int | None = None, kind: FixKind | str | None = None) -> Fixes:
        """All fixes so far (or those told with one segment) as arrays; see :meth:`Client.positions` for ``kind``."""
        return self._client.positions(self.id, seq=seq, kind=kind)

    def trajectory(self) -> Fixes:
        """The smoothed trajectory from all segments processed so far: better than positions, but only afterwards."""
        return self._client.trajectory(self.id)

    def close(self) -> SessionInfo:
        """Close the session; closing twice does no harm."""
        self.info = self._client.close_session(self.id)
        return self.info
