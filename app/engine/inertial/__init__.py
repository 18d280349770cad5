"""Motion from inertial samples: tilt, heading, steps, stride, dead reckoning."""

from app.engine.inertial.attitude import Attitude, LevelledSamples, initial_attitude, level_samples
from app.engine.inertial.conditioning import common_time_base, window_means
from app.engine.inertial.events import StepEvents
from app.engine.inertial.pedestrian import PedestrianState, advance, gap_before
from app.engine.inertial.steps import Steps, detect_steps, find_steps, settled_until

__all__ = [
    "Attitude",
    "LevelledSamples",
    "PedestrianState",
    "StepEvents",
    "Steps",
    "advance",
    "common_time_base",
    "detect_steps",
    "find_steps",
    "gap_before",
    "initial_attitude",
    "level_samples",
    "settled_until",
    "window_means",
]
