"""What is known about a device's magnetometer and its carrier's stride, from one session to the next."""

from app.engine.calibration.memory import (
    MemoryLaw,
    next_epoch,
    next_session,
    remember,
    remember_strides,
    unknown_device,
)
from app.engine.calibration.soft_iron import Reading, SoftIron, SoftIronLaw, without_soft_iron

__all__ = [
    "MemoryLaw",
    "Reading",
    "SoftIron",
    "SoftIronLaw",
    "next_epoch",
    "next_session",
    "remember",
    "remember_strides",
    "unknown_device",
    "without_soft_iron",
]
