"""The calls of the API, each written down once for both clients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar
from urllib.parse import quote

import httpx
import numpy as np
from pydantic import BaseModel

from isodyn_client.aids import Aids, BleScans, WifiScans
from isodyn_client.calls import (
    Call,
    Listing,
    as_bytes,
    as_model,
    fresh_idempotency_key,
    nothing,
    prefer_wait,
    present,
)
from isodyn_client.encoding import Encoding, json_body, raw_body, samples_body
from isodyn_client.errors import UnexpectedAnswerError
from isodyn_client.fixes import Coverage, CoverageRuns, FieldRaster, Fixes
from isodyn_client.models import (
    Anchor,
    ApiKey,
    Contribution,
    Device,
    DeviceModel,
    Extent,
    FeatureSet,
    FixKind,
    Job,
    JobState,
    LastingChange,
    Level,
    MapDiff,
    MapInfo,
    MapSource,
    Method,
    NewApiKey,
    Page,
    Prior,
    Publication,
    Scope,
    SessionInfo,
    SessionStatus,
    Stats,
    Survey,
    Venue,
    VenueKind,
    Walk,
    WalkTrack,
)
from isodyn_client.planning import MapQuality, RouteForecast, Suggestions
from isodyn_client.results import LocateResult, PositionPage, Replay, SegmentInfo, SegmentResult, Trajectory
from isodyn_client.samples import Samples, Waypoints

T = TypeVar("T", bound=BaseModel)

PAGE = 100
"""Items a page when a list is walked through."""


def _get(path: str, model: type[T]) -> Call[T]:
    return Call("GET", path, as_model(model))


def _list(path: str, model: type[T], **params: str | None) -> Listing[T]:
    query = present({**params, "limit": PAGE})
    return Listing(Call("GET", path, as_model(Page[model]), params=query))  # type: ignore[valid-type]


def _create(path: str, model: type[T], /, **fields: Any) -> Call[T]:
    return Call("POST", path, as_model(model), headers=fresh_idempotency_key(), body=json_body(present(fields)))


# Venues and levels


def create_venue(name: str, *, kind: VenueKind | str = VenueKind.INDOOR, anchor: Anchor | None = None) -> Call[Venue]:
    """Create a venue: a place with one local frame. ``anchor`` takes the frame to WGS 84."""
    return _create("/v1/venues", Venue, name=name, kind=str(kind), anchor=anchor and anchor.model_dump())


def venue(venue_id: str) -> Call[Venue]:
    """One venue."""
    return _get(f"/v1/venues/{venue_id}", Venue)


def venues(
    *,
    near: tuple[float, float] | None = None,
    radius_m: float | None = None,
    bbox: tuple[float, float, float, float] | None = None,
    q: str | None = None,
) -> Listing[Venue]:
    """Venues, newest first; all, or those of a place or a name.

    ``near`` is ``(latitude, longitude)`` in degrees: what lies within ``radius_m`` (1 km unless given), nearest first.
    ``bbox`` is ``(lon_min, lat_min, lon_max, lat_max)``. ``q`` holds words of the name, or their beginnings. Venues
    without an anchor are not found by place.
    """
    return _list("/v1/venues", Venue, **_searched(near, radius_m, bbox, q))


def update_venue(venue_id: str, *, name: str | None = None, anchor: Anchor | None = None) -> Call[Venue]:
    """Change the name or the anchor of a venue; what is None stays."""
    fields = present({"name": name, "anchor": anchor and anchor.model_dump()})
    return Call("PATCH", f"/v1/venues/{venue_id}", as_model(Venue), body=json_body(fields))


def delete_venue(venue_id: str) -> Call[None]:
    """Delete a venue that has no levels."""
    return Call("DELETE", f"/v1/venues/{venue_id}", nothing)


def create_level(
    venue_id: str, name: str, *, ordinal: int = 0, extent: Extent | tuple[float, float, float, float]
) -> Call[Level]:
    """Create a level; ``extent`` is ``(x_min, y_min, x_max, y_max)`` in metres, ``ordinal`` 0 the ground floor."""
    return _create(f"/v1/venues/{venue_id}/levels", Level, name=name, ordinal=ordinal, extent=_corners(extent))


def update_level(
    level_id: str,
    *,
    name: str | None = None,
    ordinal: int | None = None,
    extent: Extent | tuple[float, float, float, float] | None = None,
) -> Call[Level]:
    """Change name, storey or extent of a level; what is None stays. The plan image is stretched with the extent."""
    fields = present({"name": name, "ordinal": ordinal, "extent": None if extent is None else _corners(extent)})
    return Call("PATCH", f"/v1/levels/{level_id}", as_model(Level), body=json_body(fields))


def _corners(extent: Extent | tuple[float, float, float, float]) -> dict[str, float]:
    if isinstance(extent, Extent):
        return extent.model_dump()
    return dict(zip(("x_min", "y_min", "x_max", "y_max"), map(float, extent), strict=True))


def level(level_id: str) -> Call[Level]:
    """One level."""
    return _get(f"/v1/levels/{level_id}", Level)


def levels(
    *,
    venue_id: str | None = None,
    near: tuple[float, float] | None = None,
    radius_m: float | None = None,
    bbox: tuple[float, float, float, float] | None = None,
    q: str | None = None,
    ordinal: int | None = None,
) -> Listing[Level]:
    """Levels (of one venue, of one height order), newest first; ``near``, ``bbox`` and ``q`` as for :func:`venues`."""
    storey = None if ordinal is None else str(ordinal)
    return _list("/v1/levels", Level, venue_id=venue_id, ordinal=storey, **_searched(near, radius_m, bbox, q))


def _searched(
    near: tuple[float, float] | None,
    radius_m: float | None,
    bbox: tuple[float, float, float, float] | None,
    q: str | None,
) -> dict[str, str | None]:
    return {
        "near": None if near is None else _degrees(near),
        "radius_m": None if radius_m is None else f"{radius_m:.10g}",
        "bbox": None if bbox is None else _degrees(bbox),
        "q": q,
    }


def _degrees(values: Sequence[float]) -> str:
    return ",".join(f"{value:.9f}" for value in values)


def set_plan_image(level_id: str, png: bytes) -> Call[None]:
    """Store the plan image of a level (PNG; it is stretched over the level's extent)."""
    return Call("PUT", f"/v1/levels/{level_id}/plan.png", nothing, body=raw_body(png, "image/png"))


def plan_image(level_id: str) -> Call[bytes]:
    """The plan image of a level, PNG."""
    return Call("GET", f"/v1/levels/{level_id}/plan.png", as_bytes)


def set_vector_plan(level_id: str, geojson: bytes) -> Call[None]:
    """Store the vector plan of a level: a GeoJSON FeatureCollection in level metres."""
    return Call("PUT", f"/v1/levels/{level_id}/plan.geojson", nothing, body=raw_body(geojson, "application/geo+json"))


def vector_plan(level_id: str) -> Call[bytes]:
    """The vector plan of a level, GeoJSON in level metres."""
    return Call("GET", f"/v1/levels/{level_id}/plan.geojson", as_bytes)


# Devices


def create_device(name: str, *, model: str | None = None) -> Call[Device]:
    """Register a physical sensor carrier."""
    return _create("/v1/devices", Device, name=name, model=model)


def device(device_id: str) -> Call[Device]:
    """One device, with what its closed sessions taught about it."""
    return _get(f"/v1/devices/{device_id}", Device)


def devices() -> Listing[Device]:
    """All devices, newest first."""
    return _list("/v1/devices", Device)


def forget_calibrations(device_id: str) -> Call[None]:
    """Forget what sessions taught about a device: the next one starts as with a new device."""
    return Call("DELETE", f"/v1/devices/{device_id}/calibrations", nothing)


def device_models() -> Listing[DeviceModel]:
    """Models that devices name, by name, without estimates."""
    return _list("/v1/device-models", DeviceModel)


def device_model(name: str) -> Call[DeviceModel]:
    """One model, with what its devices have in common."""
    return _get(f"/v1/device-models/{quote(name, safe='')}", DeviceModel)


# Surveys and maps


def create_survey(level_id: str, name: str) -> Call[Survey]:
    """Open a survey of a level, to upload walks into."""
    return _create("/v1/surveys", Survey, level_id=level_id, name=name)


def survey(survey_id: str) -> Call[Survey]:
    """One survey."""
    return _get(f"/v1/surveys/{survey_id}", Survey)


def surveys(*, level_id: str | None = None) -> Listing[Survey]:
    """All surveys (of one level), newest first."""
    return _list("/v1/surveys", Survey, level_id=level_id)


def add_walk(
    survey_id: str,
    name: str,
    samples: Samples,
    waypoints: Waypoints,
    *,
    wifi: WifiScans | None = None,
    ble: BleScans | None = None,
    device_id: str | None = None,
    calibration_epoch: str | None = None,
    encoding: Encoding | str = Encoding.MSGPACK,
    gzip: bool = False,
) -> Call[Walk]:
    """Upload a survey walk. The same content again gives the walk that is there already.

    A walk that names its device, and the epoch of its magnetometer as sessions do, teaches it its offset and stride.

    The body is encoded while it is sent, so a long walk does not exist twice in memory.
    """
    fields = present({"name": name, "device_id": device_id, "calibration_epoch": calibration_epoch})
    aids = Aids(wifi=wifi, ble=ble)
    body = samples_body(fields, samples, aids=aids, waypoints=waypoints, encoding=encoding, gzip=gzip)
    return Call("POST", f"/v1/surveys/{survey_id}/walks", as_model(Walk), body=body)


def walk(survey_id: str, walk_id: str) -> Call[Walk]:
    """One survey walk, without its samples."""
    return _get(f"/v1/surveys/{survey_id}/walks/{walk_id}", Walk)


def walks(survey_id: str) -> Listing[Walk]:
    """The walks of a survey, oldest first."""
    return _list(f"/v1/surveys/{survey_id}/walks", Walk)


def waypoints(level_id: str, *, survey_id: str | None = None) -> Listing[WalkTrack]:
    """Where the survey walks of a level went, oldest first."""
    return _list(f"/v1/levels/{level_id}/waypoints", WalkTrack, survey_id=survey_id)


def delete_walk(survey_id: str, walk_id: str) -> Call[None]:
    """Delete a survey walk; maps built from it stay as they are."""
    return Call("DELETE", f"/v1/surveys/{survey_id}/walks/{walk_id}", nothing)


def request_map(
    level_id: str,
    *,
    survey_ids: Sequence[str] | None = None,
    features: FeatureSet | str | None = None,
    cell_m: float | None = None,
    mapped_m: float | None = None,
    align: bool | None = None,
    publish: bool | None = None,
    mode: str | None = None,
) -> Call[Job]:
    """Ask for a map of a level, from all its surveys or only some; returns the job that builds it.

    With ``mode="update"`` the current map is brought up to date instead, with the settings it has. Not repeatable: each
    request builds another version. ``build_map`` and ``update_map`` also wait for the job.
    """
    fields = present(
        {
            "level_id": level_id,
            "survey_ids": list(survey_ids) if survey_ids is not None else None,
            "features": str(features) if features is not None else None,
            "cell_m": cell_m,
            "mapped_m": mapped_m,
            "align": align,
            "publish": publish,
            "mode": mode,
        }
    )
    return Call("POST", "/v1/maps", as_model(Job), body=json_body(fields), repeatable=False)


def publish_map(level_id: str, map_id: str, *, note: str | None = None) -> Call[Publication]:
    """Make a map version the one that new sessions on the level use; an older one rolls back.

    Sessions that are open keep theirs. ``note`` says why, for the log of :func:`publications`.
    """
    fields = present({"map_id": map_id, "note": note})
    return Call("PUT", f"/v1/levels/{level_id}/map", as_model(Publication), body=json_body(fields))


def publications(level_id: str) -> Listing[Publication]:
    """Which map version was published on a level when, by whom and in place of which; newest first."""
    return _list(f"/v1/levels/{level_id}/publications", Publication)


def map_sources(map_id: str) -> Listing[MapSource]:
    """Who contributed to a map version, and walks that were left out with the reason."""
    return _list(f"/v1/maps/{map_id}/sources", MapSource)


def map_diff(map_id: str, *, against: str | None = None, least_ut: float | None = None) -> Call[MapDiff]:
    """What a map version changed against another one (its parent, unless one is named), in numbers.

    A node is changed if its field moved by more than ``least_ut`` microtesla.
    """
    params = present({"against": against, "least_ut": least_ut})
    return Call("GET", f"/v1/maps/{map_id}/diff", as_model(MapDiff), params=params)


def map_change(
    map_id: str, *, against: str | None = None, component: str = "all", statistic: str = "change"
) -> Call[FieldRaster]:
    """The change of a map's field as a numpy array, new minus old, uT, NaN where either version is not mapped.

    ``component`` is ``all`` (length of the change) or a channel; with ``statistic="significance"`` in combined standard
    deviations instead.
    """
    return Call("GET", f"/v1/maps/{map_id}/diff", _as_raster, params=_change(against, component, statistic, "f32"))


def map_change_image(
    map_id: str, *, against: str | None = None, component: str = "all", statistic: str = "change"
) -> Call[bytes]:
    """The same as a PNG, north up, transparent where either version is not mapped."""
    return Call("GET", f"/v1/maps/{map_id}/diff", as_bytes, params=_change(against, component, statistic, "png"))


def _change(against: str | None, component: str, statistic: str, form: str) -> dict[str, str]:
    return present({"against": against, "component": component, "statistic": statistic, "format": form})


def map_info(map_id: str) -> Call[MapInfo]:
    """A map version without its cells."""
    return _get(f"/v1/maps/{map_id}", MapInfo)


def maps(*, level_id: str | None = None) -> Listing[MapInfo]:
    """All map versions (of one level), newest first."""
    return _list("/v1/maps", MapInfo, level_id=level_id)


def map_field(map_id: str, channel: str, *, statistic: str = "mean") -> Call[FieldRaster]:
    """One channel of a map as a numpy array, uT (``support``: metres to the nearest survey sample).

    Channels are those of the map's features, ``x y z`` (vector) or ``h v`` (hv), and ``total`` for the magnitude;
    ``statistic`` is ``mean``, ``sd`` or ``support``.
    """
    params = {"channel": channel, "statistic": statistic, "format": "f32"}
    return Call("GET", f"/v1/maps/{map_id}/field", _as_raster, params=params)


def map_image(map_id: str, channel: str, *, statistic: str = "mean") -> Call[bytes]:
    """One channel of a map as a PNG, north up, transparent where there is no map."""
    params = {"channel": channel, "statistic": statistic, "format": "png"}
    return Call("GET", f"/v1/maps/{map_id}/field", as_bytes, params=params)


def map_coverage(map_id: str) -> Call[Coverage]:
    """Where a map holds, as a mask with its share and area."""
    return Call("GET", f"/v1/maps/{map_id}/coverage", _as_coverage)


def map_quality(map_id: str) -> Call[MapQuality]:
    """How good a map is: coverage of the walkable space, expected accuracy, where walks disagree."""
    return _get(f"/v1/maps/{map_id}/quality", MapQuality)


def quality_raster(map_id: str, layer: str = "mean_error", *, heading_deg: int | None = None) -> Call[FieldRaster]:
    """One layer of a map's quality as a numpy array, NaN where there is nothing to say.

    Layers are ``mean_error``, ``worst_error``, ``error``, ``along``, ``across`` (metres; the last three of one heading:
    0, 45, ... 315), ``coverage``, ``conflict``, ``sources`` and ``age`` (days from the newest evidence to the making
    of the map).
    """
    params = present({"layer": layer, "heading_deg": heading_deg, "format": "f32"})
    return Call("GET", f"/v1/maps/{map_id}/quality/raster", _as_raster, params=params)


def quality_image(map_id: str, layer: str = "mean_error", *, heading_deg: int | None = None) -> Call[bytes]:
    """One layer of a map's quality as a PNG, north up, transparent where there is nothing to say."""
    params = present({"layer": layer, "heading_deg": heading_deg, "format": "png"})
    return Call("GET", f"/v1/maps/{map_id}/quality/raster", as_bytes, params=params)


def survey_suggestions(map_id: str, *, count: int = 10) -> Call[Suggestions]:
    """Lines whose survey would teach the map most per metre, best first."""
    return Call("GET", f"/v1/maps/{map_id}/suggestions", as_model(Suggestions), params={"count": count})


def suggestions_geojson(map_id: str, *, count: int = 10) -> Call[bytes]:
    """The same as GeoJSON in WGS 84; the venue needs an anchor."""
    headers = {"Accept": "application/geo+json"}
    return Call("GET", f"/v1/maps/{map_id}/suggestions", as_bytes, params={"count": count}, headers=headers)


def forecast_route(
    map_id: str, route: Sequence[tuple[float, float]], *, known_m: float | None = None
) -> Call[RouteForecast]:
    """Expected accuracy along a route (corners in level metres), and where the position will be lost or doubtful.

    ``known_m`` is the standard deviation of the position at its start, per axis (3 m unless given).
    """
    columns = {"x": [float(x) for x, _ in route], "y": [float(y) for _, y in route]}
    fields = present({"route": columns, "known_m": known_m})
    return Call("POST", f"/v1/maps/{map_id}/forecast", as_model(RouteForecast), body=json_body(fields))


def export_map(map_id: str, *, format: str = "netcdf", licence: str | None = None) -> Call[bytes]:  # noqa: A002
    """A map as a file: ``netcdf`` (CF), ``geotiff`` or ``esri-ascii`` (zip files of one layer each), or ``xyz``.

    ``licence`` is what the file shall name. Files hold no radio addresses and nothing about devices.
    """
    params = present({"format": format, "licence": licence})
    return Call("GET", f"/v1/maps/{map_id}/export", as_bytes, params=params, wait_s=120.0)


def import_map(
    level_id: str,
    content: bytes,
    *,
    format: str,  # noqa: A002
    channel: str | None = None,
    unit: str | None = None,
    sd: float | None = None,
    title: str | None = None,
    licence: str | None = None,
    attribution: str | None = None,
    publish: bool = True,
) -> Call[MapInfo]:
    """Store the map of a file (see ``export_map`` for the formats) as the level's next version.

    ``channel`` names the only layer of a file (``x y z h v total``), ``unit`` is ``uT`` or ``nT``, ``sd`` (uT) the
    standard deviation where the file has none. With ``publish=False`` the level's current map stays.

    Not repeatable: each request stores another version.
    """
    params = present(
        {
            "format": format,
            "channel": channel,
            "unit": unit,
            "sd": sd,
            "title": title,
            "licence": licence,
            "attribution": attribution,
            "publish": None if publish else "false",
        }
    )
    body = raw_body(content, "application/octet-stream", gzip=True)
    path = f"/v1/levels/{level_id}/maps/import"
    return Call("POST", path, as_model(MapInfo), params=params, body=body, repeatable=False, wait_s=120.0)


def export_survey(survey_id: str, *, radio: bool = False) -> Call[bytes]:
    """All walks of a survey as a zip file; with ``radio`` also their Wi-Fi and BLE readings (addresses)."""
    params = present({"radio": "true" if radio else None})
    return Call("GET", f"/v1/surveys/{survey_id}/export", as_bytes, params=params, wait_s=120.0)


def _as_coverage(response: httpx.Response) -> Coverage:
    runs = as_model(CoverageRuns)(response)
    try:
        return Coverage.from_runs(runs)
    except ValueError as error:
        raise UnexpectedAnswerError(f"{response.request.url} sent no coverage: {error}") from error


def _as_raster(response: httpx.Response) -> FieldRaster:
    try:
        rows, columns = (int(response.headers[f"X-Isodyn-{name}"]) for name in ("Rows", "Columns"))
        x0, y0, cell_m = (float(response.headers[f"X-Isodyn-{name}"]) for name in ("X0", "Y0", "Cell-M"))
        values = np.frombuffer(response.content, dtype="<f4").reshape(rows, columns)
    except (KeyError, ValueError) as error:
        raise UnexpectedAnswerError(f"{response.request.url} sent no field raster: {error}") from error
    return FieldRaster(values.astype(np.float32), x0, y0, cell_m)


# Contributions of sessions to maps


def contributions(
    *,
    level_id: str | None = None,
    session_id: str | None = None,
    contributor: str | None = None,
    state: str | None = None,
) -> Listing[Contribution]:
    """What sessions offered to maps, newest first."""
    return _list(
        "/v1/contributions",
        Contribution,
        level_id=level_id,
        session_id=session_id,
        contributor=contributor,
        state=state,
    )


def contribution(contribution_id: str) -> Call[Contribution]:
    """One contribution."""
    return _get(f"/v1/contributions/{contribution_id}", Contribution)


def reject_contribution(contribution_id: str) -> Call[Contribution]:
    """Take a contribution out of its map, whatever the weighing says of it."""
    return Call("POST", f"/v1/contributions/{contribution_id}/reject", as_model(Contribution))


def restore_contribution(contribution_id: str) -> Call[Contribution]:
    """Offer a rejected contribution again."""
    return Call("POST", f"/v1/contributions/{contribution_id}/restore", as_model(Contribution))


def delete_contribution(contribution_id: str) -> Call[None]:
    """Forget a contribution for good."""
    return Call("DELETE", f"/v1/contributions/{contribution_id}", nothing)


def field_changes(*, level_id: str | None = None) -> Listing[LastingChange]:
    """Lasting changes of the field that independent passes agree on, newest first."""
    return _list("/v1/changes", LastingChange, level_id=level_id)


# Sessions


def create_session(
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
) -> Call[SessionInfo]:
    """Open a session: one trip of one device, on a level, or with ``venue_id`` instead on any level of a venue.

    Without a method the service's default is used. A session that names its device starts with what earlier ones taught
    about it. ``calibration_epoch`` is any text that changes when the platform recalibrates its magnetometer, such as a
    hash of the hard-iron bias it reports. With ``contribute`` what the session saw is offered to the maps when it is
    closed: ask whoever carries the device.
    """
    return _create(
        "/v1/sessions",
        SessionInfo,
        level_id=level_id,
        venue_id=venue_id,
        method=method,
        parameters=parameters,
        prior=prior and prior.model_dump(exclude_none=True),
        device_id=device_id,
        map_id=map_id,
        map_ids=None if map_ids is None else list(map_ids),
        calibration_epoch=calibration_epoch,
        contribute=contribute,
    )


def session_info(session_id: str) -> Call[SessionInfo]:
    """One session as the service keeps it."""
    return _get(f"/v1/sessions/{session_id}", SessionInfo)


def sessions(
    *,
    venue_id: str | None = None,
    level_id: str | None = None,
    device_id: str | None = None,
    status: SessionStatus | str | None = None,
) -> Listing[SessionInfo]:
    """All sessions (in one venue, opened on one level, of one device, open or closed), newest first."""
    status = str(status) if status is not None else None
    wanted = {"venue_id": venue_id, "level_id": level_id, "device_id": device_id, "status": status}
    return _list("/v1/sessions", SessionInfo, **wanted)


def close_session(session_id: str) -> Call[SessionInfo]:
    """Close a session; closing twice does no harm."""
    return Call("POST", f"/v1/sessions/{session_id}/close", as_model(SessionInfo))


def send_segment(
    session_id: str,
    seq: int,
    samples: Samples,
    *,
    aids: Aids | None = None,
    wait: float | None = None,
    encoding: Encoding | str = Encoding.MSGPACK,
    gzip: bool = False,
) -> Call[SegmentResult]:
    """Send segment ``seq`` (from 0, without gaps) and, with ``wait``, up to that many seconds for its fixes.

    Sending the same samples under the same number again is safe: the first answer comes back.
    """
    body = samples_body({"seq": seq}, samples, aids=aids, encoding=encoding, gzip=gzip)
    path = f"/v1/sessions/{session_id}/segments"
    return Call("POST", path, as_model(SegmentResult), headers=prefer_wait(wait), body=body, wait_s=wait or 0.0)


def segment(session_id: str, seq: int) -> Call[SegmentResult]:
    """One segment: where it stands, and its fixes once it is processed."""
    return _get(f"/v1/sessions/{session_id}/segments/{seq}", SegmentResult)


def segments(session_id: str) -> Listing[SegmentInfo]:
    """The segments of a session, oldest first, without their fixes."""
    return _list(f"/v1/sessions/{session_id}/segments", SegmentInfo)


def position_page(
    session_id: str,
    *,
    seq: int | None = None,
    kind: FixKind | str | None = None,
    cursor: str | None = None,
    limit: int = 500,
) -> Call[PositionPage]:
    """One page of the fixes of a session (``filtered`` unless a kind is named), oldest first."""
    params = present({"seq": seq, "kind": kind, "cursor": cursor, "limit": limit})
    return Call("GET", f"/v1/sessions/{session_id}/positions", as_model(PositionPage), params=params)


def positions_geojson(session_id: str, *, seq: int | None = None, kind: FixKind | str | None = None) -> Call[bytes]:
    """The first 500 fixes (``filtered`` unless a kind is named) as GeoJSON in WGS 84; the venue needs an anchor."""
    return Call(
        "GET",
        f"/v1/sessions/{session_id}/positions",
        as_bytes,
        params=present({"seq": seq, "kind": kind, "limit": 500}),
        headers={"Accept": "application/geo+json"},
    )


def trajectory(session_id: str) -> Call[Fixes]:
    """The smoothed trajectory of a session, for afterwards: one fix per step, from the samples before and after it."""
    read = as_model(Trajectory)
    path = f"/v1/sessions/{session_id}/trajectory"
    return Call("GET", path, lambda response: read(response).fixes, wait_s=120.0)


def replay(session_id: str, *, map_id: str | None = None, map_ids: Sequence[str] | None = None) -> Call[Replay]:
    """Take the stored segments of a session once more on other map versions, and compare with what was told then.

    On the current maps unless some are named, at most one a level. Nothing is stored.
    """
    fields = present({"map_id": map_id, "map_ids": list(map_ids) if map_ids is not None else None})
    path = f"/v1/sessions/{session_id}/replay"
    return Call("POST", path, as_model(Replay), body=json_body(fields), wait_s=120.0)


def locate(
    level_id: str | None,
    samples: Samples,
    *,
    venue_id: str | None = None,
    method: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    prior: Prior | None = None,
    map_id: str | None = None,
    aids: Aids | None = None,
    encoding: Encoding | str = Encoding.MSGPACK,
    gzip: bool = False,
) -> Call[LocateResult]:
    """Locate one stretch of samples, without a session; nothing is stored.

    With ``level_id`` None and a ``venue_id``: on any level of the venue.
    """
    fields = present(
        {
            "level_id": level_id,
            "venue_id": venue_id,
            "method": method,
            "parameters": parameters,
            "prior": prior and prior.model_dump(exclude_none=True),
            "map_id": map_id,
        }
    )
    body = samples_body(fields, samples, aids=aids, encoding=encoding, gzip=gzip)
    return Call("POST", "/v1/locate", as_model(LocateResult), body=body, wait_s=30.0)


# Jobs, methods, keys, service


def job(job_id: str) -> Call[Job]:
    """One job."""
    return _get(f"/v1/jobs/{job_id}", Job)


def jobs(*, kind: str | None = None, state: JobState | str | None = None) -> Listing[Job]:
    """All jobs (of one kind, in one state), newest first."""
    return _list("/v1/jobs", Job, kind=kind, state=str(state) if state is not None else None)


def cancel_job(job_id: str) -> Call[Job]:
    """Cancel a job that is not finished."""
    return Call("POST", f"/v1/jobs/{job_id}/cancel", as_model(Job))


def methods() -> Listing[Method]:
    """The positioning methods of the service with their parameters."""
    return Listing(Call("GET", "/v1/methods", as_model(Page[Method])))


def method(name: str) -> Call[Method]:
    """One positioning method."""
    return _get(f"/v1/methods/{name}", Method)


def create_key(name: str, scopes: Sequence[Scope | str]) -> Call[NewApiKey]:
    """Create an API key; its secret is told this once.

    Not repeatable: nobody keeps the secret, so a repetition could not be answered with it.
    """
    body = json_body({"name": name, "scopes": [str(scope) for scope in scopes]})
    return Call("POST", "/v1/keys", as_model(NewApiKey), body=body, repeatable=False)


def keys() -> Listing[ApiKey]:
    """All API keys without their secrets, newest first."""
    return _list("/v1/keys", ApiKey)


def key(key_id: str) -> Call[ApiKey]:
    """One API key without its secret."""
    return _get(f"/v1/keys/{key_id}", ApiKey)


def current_key() -> Call[ApiKey]:
    """The API key that the call is made with: its name and scopes."""
    return _get("/v1/keys/current", ApiKey)


def revoke_key(key_id: str) -> Call[None]:
    """Revoke an API key, at once and for good."""
    return Call("DELETE", f"/v1/keys/{key_id}", nothing)


def stats() -> Call[Stats]:
    """Counts for operators."""
    return _get("/v1/stats", Stats)


def ready() -> Call[None]:
    """Whether the service is ready for work; raises when it is not."""
    return Call("GET", "/readyz", nothing)
