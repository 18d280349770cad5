import asyncio
import threading

from app.workers.broker import JobBroker
from app.workers.events import JobEvents
from tests.workers.jobs import make_job


def test_waiting_ends_when_the_job_does() -> None:
    async def scenario() -> None:
        broker = JobBroker()
        waiting = [asyncio.create_task(broker.wait("job_1", 30)) for _ in range(3)]
        other = asyncio.create_task(broker.wait("job_2", 30))
        while broker.waiting < 2:
            await asyncio.sleep(0)
        job = make_job("job_1")
        thread = threading.Thread(target=broker.job_finished, args=(job,))
        thread.start()
        assert await asyncio.gather(*waiting) == [job] * 3
        thread.join()
        assert not other.done()
        other.cancel()
        await asyncio.gather(other, return_exceptions=True)
        assert broker.waiting == 0

    asyncio.run(scenario())


def test_a_job_that_ended_before_anyone_waited_is_remembered() -> None:
    broker = JobBroker()
    job = make_job("job_1")
    broker.job_finished(job)
    assert asyncio.run(broker.wait("job_1", 30)) is job


def test_only_so_many_are_remembered() -> None:
    broker = JobBroker()
    for i in range(5000):
        broker.job_finished(make_job(f"job_{i}"))
    assert asyncio.run(broker.wait("job_0", 0.01)) is None
    assert asyncio.run(broker.wait("job_4999", 0.01)) is not None


def test_patience_ends_and_leaves_nothing_behind() -> None:
    broker = JobBroker()
    assert asyncio.run(broker.wait("job_1", 0.01)) is None
    assert broker.waiting == 0


def test_a_job_that_ends_after_its_loop_was_closed_harms_nobody() -> None:
    broker = JobBroker()
    loop = asyncio.new_event_loop()
    waiting = loop.create_task(broker.wait("job_1", 30))
    while not broker.waiting:
        loop.run_until_complete(asyncio.sleep(0))
    waiting._log_destroy_pending = False  # type: ignore[attr-defined]
    loop.close()
    broker.job_finished(make_job("job_1"))
    assert broker.waiting == 0


def test_all_finishing_at_once_from_many_threads() -> None:
    async def scenario() -> None:
        broker = JobBroker()
        jobs = [make_job(f"job_{i}") for i in range(200)]
        threads = [
            threading.Thread(target=lambda part=part: [broker.job_finished(job) for job in part])
            for part in (jobs[:100], jobs[100:])
        ]
        for thread in threads:
            thread.start()
        assert await asyncio.gather(*(broker.wait(job.id, 30) for job in jobs)) == jobs
        for thread in threads:
            thread.join()

    asyncio.run(scenario())


def test_events_reach_every_listener_in_order() -> None:
    heard: list[tuple[str, str, str]] = []

    class Ear:
        def __init__(self, name: str) -> None:
            self.name = name

        def job_queued(self, job: object) -> None:
            heard.append((self.name, "queued", job.id))  # type: ignore[attr-defined]

        def job_finished(self, job: object) -> None:
            heard.append((self.name, "finished", job.id))  # type: ignore[attr-defined]

    events = JobEvents()
    events.job_queued(make_job("job_0"))
    events.add(Ear("a"))
    events.add(Ear("b"))
    events.job_queued(make_job("job_1"))
    events.job_finished(make_job("job_1"))
    assert heard == [
        ("a", "queued", "job_1"),
        ("b", "queued", "job_1"),
        ("a", "finished", "job_1"),
        ("b", "finished", "job_1"),
    ]
