"""Recursive estimators."""

from app.engine.filtering.particle import Cloud, Estimate, FilterGrid, ParticleNoise, advance_cloud, prepare_grid

__all__ = ["Cloud", "Estimate", "FilterGrid", "ParticleNoise", "advance_cloud", "prepare_grid"]
