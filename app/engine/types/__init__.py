"""Data types of the engine: frozen dataclasses over numpy arrays.

Conventions (frames, units, time) are those of :mod:`app.engine`.
"""

from app.engine.types.arrays import (
    BoolArray,
    ComplexArray,
    Float32Array,
    Float64Array,
    Int8Array,
    Int16Array,
    Int32Array,
    IntArray,
    Progress,
    UInt8Array,
)
from app.engine.types.devices import SOFT_IRON_UNKNOWN, DeviceCalibration, SixFloats
from app.engine.types.evidence import Evidence, EvidenceSource, SourceKind
from app.engine.types.features import FeatureSet
from app.engine.types.fixes import Fix, FixKind, Hypothesis, Status
from app.engine.types.maps import (
    GridMap,
    MapBuild,
    MapBuildSettings,
    MapSource,
    RadioMap,
    RouteLines,
    WalkReport,
)
from app.engine.types.recordings import (
    GnssFixes,
    ImuSamples,
    PressureReadings,
    RadioScans,
    Segment,
    SpeedReadings,
    StepCounts,
    SurveyWalk,
    Waypoints,
)
from app.engine.types.trackers import Answer, Prior, Tracker, TrackerState

__all__ = [
    "SOFT_IRON_UNKNOWN",
    "Answer",
    "BoolArray",
    "ComplexArray",
    "DeviceCalibration",
    "Evidence",
    "EvidenceSource",
    "FeatureSet",
    "Fix",
    "FixKind",
    "Float32Array",
    "Float64Array",
    "GnssFixes",
    "GridMap",
    "Hypothesis",
    "ImuSamples",
    "Int8Array",
    "Int16Array",
    "Int32Array",
    "IntArray",
    "MapBuild",
    "MapBuildSettings",
    "MapSource",
    "PressureReadings",
    "Prior",
    "Progress",
    "RadioMap",
    "RadioScans",
    "RouteLines",
    "Segment",
    "SixFloats",
    "SourceKind",
    "SpeedReadings",
    "Status",
    "StepCounts",
    "SurveyWalk",
    "Tracker",
    "TrackerState",
    "UInt8Array",
    "WalkReport",
    "Waypoints",
]
