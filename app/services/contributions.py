"""Contributions: what sessions offered to maps, what became of it, and the review by people."""

from __future__ import annotations

from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.clock import Clock
from app.services.errors import ConflictError
from app.services.map_changes import queue_update
from app.services.ports import JobListener, UnitOfWorkFactory
from app.services.records import Contribution, ContributionState, Job, LastingChange, Page


class ContributionService(Service):
    """Read contributions and changes of the field; take contributions out of maps and put them back."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, listener: JobListener) -> None:
        super().__init__(uow=uow, clock=clock)
        self._listener = listener

    def get(self, contribution_id: str) -> Contribution:
        """One contribution."""
        with self._uow() as uow:
            return uow.contributions.get(contribution_id)

    def list(
        self,
        *,
        level_id: str | None = None,
        session_id: str | None = None,
        contributor: str | None = None,
        state: ContributionState | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
    ) -> Page[Contribution]:
        """Contributions, newest first."""
        with self._uow() as uow:
            return uow.contributions.list(
                level_id=level_id,
                session_id=session_id,
                contributor=contributor,
                state=state,
                cursor=cursor,
                limit=check_limit(limit),
            )

    def reject(self, contribution_id: str) -> Contribution:
        """Take a contribution out of the map, whatever the weighing says of it; the level's map is updated."""
        now = self._clock()
        with self._uow(write=True) as uow:
            contribution = uow.contributions.set_state(contribution_id, ContributionState.REJECTED, now)
            job = queue_update(uow, contribution.level_id, now)
        self._tell(job)
        return contribution

    def restore(self, contribution_id: str) -> Contribution:
        """Offer a rejected contribution again; what it counts for is found by weighing. ConflictError if it was not."""
        now = self._clock()
        with self._uow(write=True) as uow:
            one = uow.contributions.get(contribution_id)
            if one.state is not ContributionState.REJECTED:
                raise ConflictError(f"contribution {contribution_id} is {one.state}, not rejected")
            state = ContributionState.OFFERED if one.n_rows else ContributionState.EMPTY
            contribution = uow.contributions.set_state(contribution_id, state, now)
            job = queue_update(uow, contribution.level_id, now)
        self._tell(job)
        return contribution

    def delete(self, contribution_id: str) -> None:
        """Forget a contribution; the level's map is updated without it."""
        now = self._clock()
        with self._uow(write=True) as uow:
            level_id = uow.contributions.get(contribution_id).level_id
            uow.contributions.delete(contribution_id)
            job = queue_update(uow, level_id, now)
        self._tell(job)

    def changes(
        self, *, level_id: str | None = None, cursor: str | None = None, limit: int = DEFAULT_LIMIT
    ) -> Page[LastingChange]:
        """Changes of the field, newest first."""
        with self._uow() as uow:
            return uow.contributions.list_changes(level_id=level_id, cursor=cursor, limit=check_limit(limit))

    def _tell(self, job: Job | None) -> None:
        if job is not None:
            self._listener.job_queued(job)
