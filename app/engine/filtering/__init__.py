"""Recursive estimators."""

from app.engine.filtering.modes import Mode, find_modes, whole
from app.engine.filtering.particle import (
    Advance,
    Cloud,
    Estimate,
    FilterGrid,
    ParticleNoise,
    advance_cloud,
    prepare_grid,
)

__all__ = [
    "Advance",
    "Cloud",
    "Estimate",
    "FilterGrid",
    "Mode",
    "ParticleNoise",
    "advance_cloud",
    "find_modes",
    "prepare_grid",
    "whole",
]
