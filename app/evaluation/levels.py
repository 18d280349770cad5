"""What a run takes of a data set: which levels need a map, their survey walks, the walks to replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from app.engine.types import SurveyWalk
from app.evaluation.datasets.ilc20 import Ilc20, Ilc20Level, RecordedWalk
from app.evaluation.drivers import FieldRaster
from app.evaluation.prepare import PreparedLevel, PrepareTask
from app.evaluation.protocol import EvaluationOptions, Scenario
from app.evaluation.replay import Job, Results


@dataclass(frozen=True, slots=True)
class LevelsOfRun:
    """Levels whose walks are replayed, and those that have a map: with the building as the prior all of its levels."""

    evaluated: tuple[Ilc20Level, ...]
    mapped: tuple[Ilc20Level, ...]

    @classmethod
    def choose(cls, data: Ilc20, options: EvaluationOptions) -> LevelsOfRun:
        """The levels that the options name (all, if they name none)."""
        evaluated = tuple(data.level(name) for name in options.levels or data.levels())
        if options.scenario is not Scenario.VENUE:
            return cls(evaluated, evaluated)
        sites = {level.site for level in evaluated}
        of_sites = (level for level in map(data.level, data.levels()) if level.site in sites)
        # lowest first, as a service offers them
        return cls(evaluated, tuple(sorted(of_sites, key=lambda level: (level.site, level.ordinal, level.name))))

    def offered(self, level: Ilc20Level, scenario: Scenario) -> tuple[str, ...]:
        """Names of the levels that a walk on ``level`` may be found on."""
        if scenario is not Scenario.VENUE:
            return (level.name,)
        return tuple(other.name for other in self.mapped if other.site == level.site)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What replaying leaves for the report. ``aids_used`` is None where that cannot be known."""

    results: Results
    prepared: Sequence[PreparedLevel]
    rasters: Mapping[str, FieldRaster]
    aids_used: bool | None = None
    notes: tuple[str, ...] = ()


def prepare_task(level: Ilc20Level, options: EvaluationOptions, *, with_map: bool) -> PrepareTask:
    """Work order for the map of a level and its surveyed area."""
    return PrepareTask(
        level.name,
        survey_walks(level, options),
        options.map_settings,
        options.cache,
        with_map=with_map,
        vector_plan=level.vector_plan,
    )


def survey_walks(level: Ilc20Level, options: EvaluationOptions) -> tuple[SurveyWalk, ...]:
    """Walks that the map is built from, with the readings that are sent as aids."""
    aids = options.aids
    walks = (walk.survey_walk() for walk in level.walks("train"))
    return tuple(
        replace(walk, wifi=walk.wifi if aids.wifi else None, ble=walk.ble if aids.ble else None) for walk in walks
    )


def walks_to_replay(level: Ilc20Level, options: EvaluationOptions) -> tuple[RecordedWalk, ...]:
    """Walks to replay."""
    return level.walks("test")[: options.limit]


def replay_job(
    level: Ilc20Level,
    ids: tuple[str, str],
    walks: tuple[RecordedWalk, ...],
    ready: PreparedLevel,
    options: EvaluationOptions,
) -> Job:
    """Work order for some walks of a level; ``ids`` are what the driver calls the level and its building."""
    return Job(level.name, *ids, walks, ready.area, options.scenario, options.aids, options.repeat)
