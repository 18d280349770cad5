"""Population searches over shift, turn and stretch, with one objective."""

from app.engine.matching.metaheuristic.fish_swarm import ENTRY as _FISH_SWARM
from app.engine.matching.metaheuristic.genetic import ENTRY as _GENETIC
from app.engine.matching.metaheuristic.particle_swarm import ENTRY as _PARTICLE_SWARM

ENTRIES = (_GENETIC, _PARTICLE_SWARM, _FISH_SWARM)

__all__ = ["ENTRIES"]
