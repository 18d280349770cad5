"""Recursive estimators."""

from app.engine.filtering.particle import (
    Advance,
    Cloud,
    Estimate,
    FilterGrid,
    ParticleNoise,
    advance_cloud,
    prepare_grid,
)

__all__ = ["Advance", "Cloud", "Estimate", "FilterGrid", "ParticleNoise", "advance_cloud", "prepare_grid"]
