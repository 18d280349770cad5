"""Magnetic maps: placing survey walks, aligning them, kriging the field."""

from app.engine.mapping.builder import build_map
from app.engine.mapping.kriging import Covariance, FieldLevel, FieldSamples, krige, krige_grid

__all__ = ["Covariance", "FieldLevel", "FieldSamples", "build_map", "krige", "krige_grid"]
