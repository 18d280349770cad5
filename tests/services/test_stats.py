from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import event

from app.services.errors import InvalidError
from app.services.ids import new_id
from app.services.records import JobKind
from app.services.stats_records import NO_FILTERS, Bucket, DiskUsage, Filters, JobTimes, Window
from app.services.stats_tables import bucket_starts, latency_rows, text_class, wilson
from app.storage.host import LocalHost
from tests.support.builders import START, World, locate_result, new_segment

DAY = Window(START - timedelta(days=1), START + timedelta(days=1))


@pytest.fixture(autouse=True)
def ids_of_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ids never go backwards, the clocks of tests do: those of other tests may have run far ahead."""
    monkeypatch.setattr(new_id, "_last", 0)


def process(world: World, session_id: str, n: int, *, apart: timedelta = timedelta(0)) -> None:
    """Accept and process segments, so far apart."""
    for seq in range(n):
        world.services.sessions.accept(session_id, new_segment(seq, n=20))
        (job,) = world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
        level_id = world.services.sessions.get(session_id).level_id
        world.services.processing.complete_locate(job, locate_result(seq, level_id=str(level_id)))
        world.clock.now += apart


@pytest.mark.parametrize(
    ("bucket", "since", "until", "expected"),
    [
        (None, START, START + timedelta(hours=5), [START]),
        (Bucket.HOUR, START + timedelta(minutes=59), START + timedelta(minutes=61), [0, 60]),
        (Bucket.HOUR, START, START + timedelta(minutes=60), [0]),
        (Bucket.MINUTE, START + timedelta(seconds=30), START + timedelta(seconds=31), [0]),
        (Bucket.DAY, START, START + timedelta(hours=17), [-480, 960]),
    ],
)
def test_buckets_cover_the_window(
    bucket: Bucket | None, since: datetime, until: datetime, expected: list[datetime | int]
) -> None:
    starts = [START + timedelta(minutes=one) if isinstance(one, int) else one for one in expected]
    assert bucket_starts(Window(since, until, bucket)) == starts


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        ("the worker died in each of 3 attempts", "the worker died in each of … attempts"),
        ("no session 'ses_1'", "no session …"),
        ("level lvl_019ab2c4d1e07f3a9b2c4d5e6f has no map\nsecond line", "level … has no map"),
        ("at (12.5, -3e-4)", "at (…, …)"),
    ],
)
def test_errors_that_say_the_same_are_one_sort(error: str, expected: str) -> None:
    assert text_class(error) == expected


def test_the_interval_of_a_share_covers_as_often_as_it_says() -> None:
    """By simulation, for a share near 1 where the normal approximation fails."""
    rng = np.random.default_rng(1)
    hits = rng.binomial(40, 0.95, size=4000)
    covered = [low <= 0.95 <= high for low, high in (wilson(int(hit), 40) for hit in hits)]
    assert 0.93 <= np.mean(covered) <= 0.98
    assert wilson(20, 20)[1] == 1.0
    assert 0.8 < wilson(20, 20)[0] < 0.9
    assert wilson(0, 5)[0] == pytest.approx(0.0)


def test_percentiles_are_those_of_the_times() -> None:
    waits = np.arange(101) / 100
    times = [
        JobTimes(
            JobKind.LOCATE_SEGMENT,
            START,
            START + timedelta(seconds=wait),
            START + timedelta(seconds=wait + 2.0),
        )
        for wait in waits
    ]
    (row,) = latency_rows(DAY, times)
    assert (row.wait_p50_ms, row.wait_p90_ms, row.wait_p99_ms) == pytest.approx((500, 900, 990))
    assert (row.processing_p50_ms, row.total_p95_ms) == pytest.approx((2000, 2950))
    late = JobTimes(JobKind.BUILD_MAP, START, START - timedelta(seconds=5), START)
    assert latency_rows(DAY, [late])[0].wait_p50_ms == 0.0


def test_a_question_reads_no_more_than_its_bound_and_says_so(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    session = world.session()
    process(world, session.id, 6, apart=timedelta(minutes=1))
    whole = world.services.stats.throughput(DAY)
    assert (whole.rows[0].segments, whole.complete_since) == (6, None)
    monkeypatch.setattr("app.services.stats.MAX_JOBS", 4)
    cut = world.services.stats.throughput(DAY)
    assert cut.rows[0].segments == 4
    assert cut.complete_since is not None
    assert START + timedelta(minutes=1) < cut.complete_since < START + timedelta(minutes=2)
    # what a filter leaves out was read too
    assert world.services.stats.throughput(DAY, Filters(device_id="dev_1")).complete_since == cut.complete_since
    # what lies before can be asked for
    before = Window(DAY.since, cut.complete_since)
    assert world.services.stats.throughput(before).rows[0].segments == 2


def test_filters_take_what_belongs_and_leave_the_rest(world: World) -> None:
    one, two = world.session(), world.session()
    process(world, one.id, 3)
    process(world, two.id, 2)
    stats = world.services.stats
    for filters, expected in (
        (Filters(level_id=one.level_id), 3),
        (Filters(venue_id=two.venue_id), 2),
        (Filters(venue_id=two.venue_id, level_id=one.level_id), 0),
        (Filters(method="particle"), 5),
        (Filters(method="dead_reckoning"), 0),
        (NO_FILTERS, 5),
    ):
        assert stats.throughput(DAY, filters).rows[0].segments == expected, filters
        located = [row.n for row in stats.latency(DAY, filters).rows if row.kind is JobKind.LOCATE_SEGMENT]
        assert located == ([expected] if expected else []), filters
        assert sum(row.n for row in stats.fixes(DAY, filters).rows) == 3 * expected, filters
    builds = {row.kind: row.n for row in stats.latency(DAY, Filters(level_id=one.level_id)).rows}
    assert builds[JobKind.BUILD_MAP] == 1


def test_failures_are_shares_of_what_ended(world: World) -> None:
    session = world.session()
    for seq, error in enumerate(["cell 1", "cell 22", None, "other"]):
        world.services.sessions.accept(session.id, new_segment(seq, n=20))
        (job,) = world.services.processing.claim(1)
        if error is None:
            world.services.processing.complete_locate(job, locate_result(seq, level_id=str(session.level_id)))
        else:
            world.services.processing.fail(job, error)
    world.services.sessions.accept(session.id, new_segment(4, n=20))
    (waiting,) = world.services.jobs.list([JobKind.LOCATE_SEGMENT], limit=1).items
    world.services.jobs.cancel(waiting.id)
    rows = world.services.stats.errors(DAY).rows
    assert [(row.text, row.n, row.share, row.example_error) for row in rows] == [
        ("cell …", 2, 0.5, "cell 22"),
        ("other", 1, 0.25, "other"),
    ]
    assert rows[0].example_seq == 1


def test_the_backlog_ages(world: World) -> None:
    session = world.session()
    world.services.sessions.accept(session.id, new_segment(0, n=20))
    world.services.sessions.accept(session.id, new_segment(1, n=20))
    world.services.processing.claim(1)
    world.clock.now += timedelta(seconds=90)
    rows = {row.kind: row for row in world.services.stats.backlog()}
    row = rows[JobKind.LOCATE_SEGMENT]
    assert (row.queued, row.running) == (1, 1)
    assert row.oldest_queued_s == pytest.approx(90, abs=0.1)
    assert row.oldest_running_s == pytest.approx(90, abs=0.1)
    assert rows[JobKind.BUILD_MAP].oldest_queued_s is None


def test_windows_are_checked(world: World) -> None:
    window = world.services.stats.window
    assert window(None, None, Bucket.MINUTE).until - window(None, START, None).until > timedelta(0)
    assert window(None, START, Bucket.DAY).since == START - timedelta(days=30)
    with pytest.raises(InvalidError, match="since"):
        window(START, START, None)
    with pytest.raises(InvalidError, match="bucket"):
        window(START - timedelta(days=2), START, Bucket.MINUTE)


@contextmanager
def statements(world: World) -> Iterator[list[tuple[str, object]]]:
    sent: list[tuple[str, object]] = []

    def executed(_connection: object, _cursor: object, statement: str, parameters: object, *_rest: object) -> None:
        sent.append((statement, parameters))

    event.listen(world.database.engine, "before_cursor_execute", executed)
    try:
        yield sent
    finally:
        event.remove(world.database.engine, "before_cursor_execute", executed)


def test_no_question_scans_the_tables_that_grow(world: World) -> None:
    session = world.session()
    process(world, session.id, 2)
    stats, filters = world.services.stats, Filters(session.venue_id, session.level_id, None, "particle")
    with statements(world) as sent:
        for table in (stats.throughput, stats.latency, stats.errors, stats.fixes, stats.accuracy):
            table(DAY, filters)
        stats.backlog()
        stats.levels(DAY)
        world.services.alarms.now()
    plans = []
    with world.database.engine.connect() as connection:
        for statement, parameters in sent:
            if statement.startswith("SELECT"):
                rows = connection.exec_driver_sql("EXPLAIN QUERY PLAN " + statement, parameters)  # type: ignore[arg-type]
                plans += [(str(row[-1]), statement) for row in rows]
    assert len(plans) > 20
    for table in ("jobs", "segments", "fixes", "segment_samples", "ground_truth", "contributions"):
        assert not [step for step in plans if step[0].startswith(f"SCAN {table}")], table


def test_disk_and_workers_are_looked_after(world: World, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("data")
    (folder / "maps").mkdir()
    (folder / "isodyn.db").write_bytes(bytes(1000))
    (folder / "isodyn.db-wal").write_bytes(bytes(200))
    (folder / "maps" / "a.npy").write_bytes(bytes(50))
    host = LocalHost(folder / "isodyn.db", folder / "maps", alive=lambda: 1, wanted=2)
    disk = host.disk()
    assert (disk.database, disk.map_cache) == (1200, 50)
    assert 0 < disk.free <= disk.total
    assert host.workers() == (1, 2)
    assert disk == DiskUsage(1200, 50, disk.free, disk.total)


def test_times_are_utc(world: World) -> None:
    session = world.session()
    process(world, session.id, 1)
    (row,) = world.services.stats.latency(Window(DAY.since, DAY.until, Bucket.HOUR)).rows[:1]
    assert row.since == START.astimezone(UTC)
