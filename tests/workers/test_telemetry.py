import json
import logging
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

from app.settings import LogLevel
from app.telemetry import METRICS, MetricKind, Metrics, configure_logging, mask
from tests.workers.jobs import make_job

DOCS = Path(__file__).resolve().parents[2] / "docs" / "metrics.md"
SECRET = "isk_0123456789abcd_Ab-cD_eF0-_x"


@pytest.fixture
def _logging() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:], root.level = handlers, level
    structlog.reset_defaults()


def test_every_metric_is_documented_as_it_is() -> None:
    rows = re.findall(r"^\| `(isodyn_\w+)` \| (\w+) \| (.*?) \| (.*?) \|$", DOCS.read_text(), flags=re.MULTILINE)
    documented = {(name, kind, tuple(re.findall(r"`(\w+)`", labels)), text) for name, kind, labels, text in rows}
    assert documented == {(m.name, m.kind.value, m.labels, m.help) for m in METRICS}


def test_every_metric_of_the_table_is_rendered_and_no_other() -> None:
    rendered = Metrics().render().decode()
    types = dict(re.findall(r"^# TYPE (isodyn_\w+) (\w+)$", rendered, flags=re.MULTILINE))
    created = {name for name in types if name.endswith("_created")}
    assert {name: kind for name, kind in types.items() if name not in created} == {
        m.name: m.kind.value for m in METRICS
    }


def test_histograms_have_buckets_that_grow() -> None:
    for metric in METRICS:
        assert bool(metric.buckets) == (metric.kind is MetricKind.HISTOGRAM)
        assert list(metric.buckets) == sorted(set(metric.buckets))


def test_jobs_are_counted_where_they_end() -> None:
    metrics = Metrics()
    metrics.job_finished(make_job("job_1"))
    assert 'isodyn_jobs_finished_total{kind="locate_segment",state="done"} 1.0' in metrics.render().decode()


@given(st.text(), st.text())
def test_a_key_is_masked_wherever_it_stands(before: str, after: str) -> None:
    masked = json.dumps(
        mask({"note": f"{before} {SECRET} {after}", "deep": [{"x": (SECRET,)}], "raw": SECRET.encode()})
    )
    assert SECRET not in masked
    assert "Ab-cD_eF0" not in masked


@pytest.mark.parametrize("name", ["Authorization", "X-API-Key", "secret", "password"])
def test_values_under_a_telling_name_are_masked_whole(name: str) -> None:
    assert mask({name: "anything at all"}) == {name: "***"}


@pytest.mark.parametrize("secret", [SECRET, "isi_x9Jm2vQ0c1p8Zt4yB6nKd3hLw7RaEf5u", "whsec_x9Jm2vQ0c1p8Zt4"])
def test_secrets_are_masked_wherever_they_stand(secret: str) -> None:
    assert mask(f'"WebSocket /v1/ingest/sensor-logger/{secret}" 403') == '"WebSocket /v1/ingest/sensor-logger/***" 403'


@pytest.mark.parametrize("as_json", [True, False])
@pytest.mark.usefixtures("_logging")
def test_no_log_line_holds_a_secret(as_json: bool, capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(LogLevel.DEBUG, as_json=as_json)
    log = structlog.stdlib.get_logger("test")
    log.info("login", authorization=f"Bearer {SECRET}", headers={"x-api-key": SECRET}, thing=ValueError(SECRET))
    log.info(f"got {SECRET}")
    logging.getLogger("library").warning("header %s", f"Bearer {SECRET}")
    try:
        raise RuntimeError(f"bad key {SECRET}")
    except RuntimeError:
        log.exception("failed")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("***") >= 5
    assert "isk_" not in captured.err
    assert "Ab-cD" not in captured.err
    assert "RuntimeError" in captured.err


@pytest.mark.usefixtures("_logging")
def test_json_lines_parse_and_carry_level_time_and_logger(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(LogLevel.INFO, as_json=True)
    structlog.stdlib.get_logger("mine").info("hello", n=3)
    logging.getLogger("library").info("n is %d", 4)
    structlog.stdlib.get_logger("mine").debug("not shown")
    first, second = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert (first["event"], first["n"], first["level"], first["logger"]) == ("hello", 3, "info", "mine")
    assert second["event"] == "n is 4"
    assert "timestamp" in first
