"""Geofences and webhooks through the command line and the client, against a real service."""

from __future__ import annotations

import csv
import io
import re

import isodyn_client as isodyn
import pytest

from app.cli.convert import samples_of
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.cli.conftest import SAMPLE, Service, Surveyed, run

WHOLE = "--polygon", "1,1 200,1 200,150 1,150"


def test_geofences_from_first_to_last(service: Service, surveyed: Surveyed, tmp_path: object) -> None:
    walk = next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))
    start = isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]), heading_deg=10.0)
    level_id = surveyed.level_id
    options = ("--event", "enter", "--event", "leave", "--event", "dwell", "--dwell", "3")
    geofence_id = service.isodyn("geofence", "create", level_id, "whole floor", *WHOLE, *options).stdout.strip()
    assert geofence_id in service.isodyn("geofence", "list", "--level", level_id).stdout
    with service.client() as client:
        assert client.geofence(geofence_id).polygon == ((1, 1), (200, 1), (200, 150), (1, 150))
        assert client.update_geofence(geofence_id, name="floor").dwell_s == 3.0
        with client.open_session(level_id, prior=start) as session:
            list(session.send_all(samples_of(walk.samples)[:1500], wait=20))
        session.wait_for(session.next_seq - 1, timeout=120.0)
        told = list(client.geofence_events(geofence_id=geofence_id))
    assert [one.kind.value for one in reversed(told)] == ["enter", "dwell", "leave"]
    assert told[0].reason == "session closed"
    assert told[1].dwell_s is not None
    assert told[1].dwell_s >= 3.0
    listed = service.isodyn("geofence", "events", "--session", session.id, "--kind", "enter").stdout
    assert "floor" in listed
    assert "leave" not in listed
    file = tmp_path / "events.csv"  # type: ignore[operator]
    service.isodyn("geofence", "events", "--geofence", geofence_id, "--after", "2015-01-01", "--csv", file)
    assert [row["id"] for row in csv.DictReader(io.StringIO(file.read_text()))] == [one.id for one in told]
    assert "no events" in service.isodyn("geofence", "events", "--before", "2001-01-01").stdout
    service.isodyn("geofence", "delete", geofence_id)
    with service.client() as client, pytest.raises(isodyn.NotFoundError):
        client.geofence(geofence_id)


def test_a_polygon_is_corners() -> None:
    for polygon in ("12", "1,2 3,x", "1,2,3 4,5"):
        result = run("geofence", "create", "lvl_1", "x", "--polygon", polygon, ISODYN_URL="http://127.0.0.1:9")
        assert result.exit_code == 2
        assert "--polygon" in result.output


def test_what_the_service_refuses_is_said(service: Service, surveyed: Surveyed) -> None:
    crossing = ("--polygon", "1,1 9,9 9,1 1,9")
    result = run(
        "geofence", "create", surveyed.level_id, "x", *crossing, ISODYN_URL=service.url, ISODYN_KEY=service.key
    )
    assert result.exit_code == 1
    assert "crosses" in result.output


def test_webhooks_from_first_to_last(service: Service, surveyed: Surveyed) -> None:
    """To an address that nobody can reach: names under ``invalid`` lead nowhere (RFC 6761)."""
    address = "https://hooks.invalid/isodyn"
    made = service.isodyn("webhook", "create", address, "--event", "session.closed", "--level", surveyed.level_id)
    webhook_id, secret = made.stdout.split()
    assert secret.startswith("whsec_")
    listed = service.isodyn("webhook", "list").stdout
    assert webhook_id in listed
    assert secret not in listed
    delivery_id = service.isodyn("webhook", "test", webhook_id).stdout.strip()
    shown = service.isodyn("webhook", "deliveries", webhook_id).stdout
    assert re.search(rf"{delivery_id}\s+test\s+pending", shown)
    assert "no deliveries" in service.isodyn("webhook", "deliveries", webhook_id, "--state", "dead").stdout
    again = ("webhook", "deliveries", webhook_id, "--again", delivery_id)
    refused = run(*again, ISODYN_URL=service.url, ISODYN_KEY=service.key)
    assert "pending" in refused.output
    with service.client() as client:
        assert client.update_webhook(webhook_id, active=False).active is False
        with pytest.raises(isodyn.ConflictError):
            client.test_webhook(webhook_id)
    service.isodyn("webhook", "delete", webhook_id)
    assert webhook_id not in service.isodyn("webhook", "list").stdout


def test_addresses_inside_are_refused(service: Service) -> None:
    with service.client() as client, pytest.raises(isodyn.InvalidRequestError) as caught:
        client.create_webhook("https://127.0.0.1/", ["map.published"])
    assert caught.value.field == "url"
