"""What is known about a device's magnetometer and its carrier's stride, from one session to the next."""

from app.engine.calibration.memory import (
    MemoryLaw,
    next_epoch,
    next_session,
    remember,
    remember_strides,
    unknown_device,
)

__all__ = ["MemoryLaw", "next_epoch", "next_session", "remember", "remember_strides", "unknown_device"]
