"""Magnetic maps: placing survey walks, aligning them, kriging the field, bringing maps up to date."""

from app.engine.mapping.builder import build_map
from app.engine.mapping.kriging import krige, krige_grid, krige_nodes
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples, MapModel, field_samples
from app.engine.mapping.plan import FloorPlan, Polygon
from app.engine.mapping.routes import RouteProfile, extend_route
from app.engine.mapping.update import MapUpdate, NewWalk, update_map

__all__ = [
    "Covariance",
    "FieldLevel",
    "FieldSamples",
    "FloorPlan",
    "MapModel",
    "MapUpdate",
    "NewWalk",
    "Polygon",
    "RouteProfile",
    "build_map",
    "extend_route",
    "field_samples",
    "krige",
    "krige_grid",
    "krige_nodes",
    "update_map",
]
