"""Magnetic maps: placing survey walks, aligning them, kriging the field."""

from app.engine.mapping.builder import build_map
from app.engine.mapping.kriging import krige, krige_grid
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples
from app.engine.mapping.plan import FloorPlan, Polygon

__all__ = ["Covariance", "FieldLevel", "FieldSamples", "FloorPlan", "Polygon", "build_map", "krige", "krige_grid"]
