"""What the two clients do with calls, written once: generators that ask for input and output instead of doing it.

A flow yields :class:`Send` (and is resumed with the answer, or with the transport's exception thrown in) or
:class:`Pause`, and returns its result. The synchronous client runs a flow with a plain loop, the asynchronous one
with the same loop and ``await``. Neither sleeps, sends nor counts on its own.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import httpx

from isodyn_client import endpoints
from isodyn_client.calls import Call
from isodyn_client.errors import (
    ConnectionFailedError,
    IsodynError,
    JobFailedError,
    RequestTimeoutError,
    StillWaitingError,
    problem_from,
)
from isodyn_client.fixes import Fixes
from isodyn_client.models import FeatureSet, FixKind, Job, JobState, MapInfo
from isodyn_client.results import SegmentResult
from isodyn_client.retry import RetryPolicy, retry_after

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Send:
    """One HTTP exchange, please."""

    call: Call[Any]


@dataclass(frozen=True, slots=True)
class Pause:
    """Some seconds of nothing, please."""

    seconds: float


Flow = Generator[Send | Pause, httpx.Response | None, T]
JobProgress = Callable[[Job], None]
"""Called with the job whenever it has been asked for."""


@dataclass(frozen=True, slots=True)
class Flows:
    """The flows, with what they have in common: policy, chance, clock."""

    policy: RetryPolicy = field(default_factory=RetryPolicy)
    rng: random.Random = field(default_factory=random.Random)
    clock: Callable[[], float] = time.monotonic
    poll_s: float = 0.2
    longest_poll_s: float = 1.0

    def exchange(self, call: Call[T]) -> Flow[T]:
        """Send a call, again where the policy allows it, and read the answer."""
        attempt = 0
        while True:
            try:
                response = yield Send(call)
            except httpx.TransportError as error:
                if not self.policy.after_failure(attempt, repeatable=call.repeatable, error=error):
                    raise _translated(error, call) from error
                asked_for = None
            else:
                assert response is not None  # noqa: S101  # a Send is resumed with its answer
                if response.is_success:
                    return call.parse(response)
                asked_for = retry_after(response)
                status = response.status_code
                if not self.policy.after_answer(
                    attempt, repeatable=call.repeatable, status=status, retry_after_s=asked_for
                ):
                    raise problem_from(response, asked_for)
            yield Pause(self.policy.pause_s(attempt, self.rng, asked_for))
            attempt += 1

    def wait_for_job(self, job_id: str, *, timeout: float = 600.0, progress: JobProgress | None = None) -> Flow[Job]:
        """Ask for a job until it is done.

        Raises
        ------
        JobFailedError
            It failed or was cancelled.
        StillWaitingError
            It was not finished after ``timeout`` seconds.
        """

        def report(job: Job) -> None:
            if progress is not None:
                progress(job)

        job = yield from self._until(
            endpoints.job(job_id), lambda job: job.state.final, f"job {job_id}", timeout, report
        )
        if job.state is not JobState.DONE:
            raise JobFailedError(job)
        return job

    def build_map(
        self,
        level_id: str,
        *,
        survey_ids: Sequence[str] | None = None,
        features: FeatureSet | str | None = None,
        cell_m: float | None = None,
        mapped_m: float | None = None,
        align: bool | None = None,
        publish: bool | None = None,
        timeout: float = 600.0,
        progress: JobProgress | None = None,
    ) -> Flow[MapInfo]:
        """Request a map of a level, wait for the job that builds it, and return the new version.

        ``cell_m`` is the grid's spacing; a node within ``mapped_m`` of a survey sample counts as mapped.
        ``align=False`` takes walks as they are: for calibrated devices along lines that hardly cross.
        ``publish=False`` builds a draft: sessions use it when they name it, or once ``publish_map`` made it current.
        ``progress`` is called with the job while it runs (``job.progress`` 0..1, ``job.progress_text``).
        """
        job = yield from self.exchange(
            endpoints.request_map(
                level_id,
                survey_ids=survey_ids,
                features=features,
                cell_m=cell_m,
                mapped_m=mapped_m,
                align=align,
                publish=publish,
            )
        )
        job = yield from self.wait_for_job(job.id, timeout=timeout, progress=progress)
        return (yield from self.exchange(endpoints.map_info(str(job.result["map_id"]))))

    def update_map(
        self, level_id: str, *, timeout: float = 600.0, progress: JobProgress | None = None
    ) -> Flow[MapInfo]:
        """Bring a level's current map up to date, wait for that, and return the new version.

        Walks uploaded since are added and those deleted since taken out; ``ConflictError`` if there are none.
        """
        job = yield from self.exchange(endpoints.request_map(level_id, mode="update"))
        job = yield from self.wait_for_job(job.id, timeout=timeout, progress=progress)
        return (yield from self.exchange(endpoints.map_info(str(job.result["map_id"]))))

    def wait_for_segment(self, session_id: str, seq: int, *, timeout: float = 60.0) -> Flow[SegmentResult]:
        """Ask for a segment until it is processed (or has failed: see its ``state``)."""
        call = endpoints.segment(session_id, seq)
        return (
            yield from self._until(call, lambda found: found.state.final, f"segment {seq} of {session_id}", timeout)
        )

    def positions(self, session_id: str, *, seq: int | None = None, kind: FixKind | str | None = None) -> Flow[Fixes]:
        """All fixes of a session (or those told with one segment) as arrays.

        ``filtered`` ones are the answers of the moment; with ``kind="fixed_lag"`` each step as it was told about five
        seconds later, better known.
        """
        parts: list[Fixes] = []
        cursor: str | None = None
        while True:
            page = yield from self.exchange(endpoints.position_page(session_id, seq=seq, kind=kind, cursor=cursor))
            parts.append(page.fixes)
            cursor = page.next_cursor
            if cursor is None:
                return Fixes.concatenate(parts)

    def _until(
        self,
        call: Call[T],
        finished: Callable[[T], bool],
        what: str,
        timeout: float,
        report: Callable[[T], None] = lambda _: None,
    ) -> Flow[T]:
        deadline = self.clock() + timeout
        pause = self.poll_s
        while True:
            found = yield from self.exchange(call)
            report(found)
            if finished(found):
                return found
            if self.clock() + pause > deadline:
                raise StillWaitingError(f"{what} was not finished after {timeout:g} s; it goes on")
            yield Pause(pause)
            pause = min(self.longest_poll_s, pause * 1.5)


def _translated(error: httpx.TransportError, call: Call[Any]) -> IsodynError:
    what = f"{call.method} {call.path}"
    if isinstance(error, httpx.TimeoutException):
        return RequestTimeoutError(f"{what}: no answer in time ({type(error).__name__})")
    return ConnectionFailedError(f"{what}: {error or type(error).__name__}")
