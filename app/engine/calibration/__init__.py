"""What is known about a device's magnetometer and its carrier's stride, from one session to the next."""

from app.engine.calibration.fleet import FleetLaw, ModelEstimate, estimate_model, own_evidence, with_model
from app.engine.calibration.memory import (
    MemoryLaw,
    next_epoch,
    next_session,
    remember,
    remember_offsets,
    remember_strides,
    unknown_device,
)
from app.engine.calibration.soft_iron import Reading, SoftIron, SoftIronLaw, without_soft_iron

__all__ = [
    "FleetLaw",
    "MemoryLaw",
    "ModelEstimate",
    "Reading",
    "SoftIron",
    "SoftIronLaw",
    "estimate_model",
    "next_epoch",
    "next_session",
    "own_evidence",
    "remember",
    "remember_offsets",
    "remember_strides",
    "unknown_device",
    "with_model",
    "without_soft_iron",
]
