"""A real service in this process, and a command line that talks to it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import uvicorn
from click.testing import Result
from isodyn_client import Client
from typer.testing import CliRunner

from app.cli.root import app
from app.main import create_app
from app.services.accounts import AccountService
from app.services.clock import utc_now
from app.services.records import Scope
from app.settings import Settings
from tests.support.builders import database_at

SAMPLE = Path("maps/samples/ilc20/site1-F2")
START_TIMEOUT_S = 120.0


@dataclass(frozen=True)
class Service:
    url: str
    key: str
    data_dir: Path

    def client(self) -> Client:
        return Client(self.url, self.key)

    def isodyn(self, *arguments: str | Path) -> Result:
        """Run a command against this service; it must succeed."""
        result = run(*arguments, ISODYN_URL=self.url, ISODYN_KEY=self.key)
        assert result.exit_code == 0, result.output
        return result


def run(*arguments: str | Path, **environment: str) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env=environment)


@pytest.fixture(scope="session")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    folder = tmp_path_factory.mktemp("service") / "data"
    return Settings(data_dir=folder, pool="threads", workers=1, port=0, log_level="warning")


@pytest.fixture(scope="session")
def service(settings: Settings) -> Iterator[Service]:
    database = database_at(settings.database_path)
    _, key = AccountService(uow=database, clock=utc_now).create_key("tests", {Scope.ADMIN})
    database.close()
    config = uvicorn.Config(create_app(settings), port=0, log_config=None, lifespan="on")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, name="service")
    thread.start()
    deadline = time.monotonic() + START_TIMEOUT_S
    while not server.started and thread.is_alive() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert server.started
    port = server.servers[0].sockets[0].getsockname()[1]
    yield Service(f"http://127.0.0.1:{port}", key, settings.data_dir)
    server.should_exit = True
    thread.join(30)


@dataclass(frozen=True)
class Surveyed:
    """A level with a few survey walks and a map, made by the command line."""

    level_id: str
    survey_id: str
    map_id: str


@pytest.fixture(scope="session")
def surveyed(service: Service) -> Surveyed:
    level_id = service.isodyn("survey", "level", SAMPLE).stdout.strip()
    survey_id = service.isodyn(
        "survey", "upload", level_id, SAMPLE, *(part for name in SURVEY_WALKS for part in ("--walk", name)), "--no-wifi"
    ).stdout.strip()
    map_id = service.isodyn("map", "build", level_id, "--cell", "1").stdout.strip()
    return Surveyed(level_id, survey_id, map_id)


SURVEY_WALKS = ("5dda04", "5dda402")
