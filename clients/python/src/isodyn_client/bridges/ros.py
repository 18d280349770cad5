"""ROS 2: messages of a fix as plain dicts, field by field as the message definitions name them.

``sensor_msgs/NavSatFix`` on the earth, ``geometry_msgs/PoseWithCovarianceStamped`` on the level. No ROS is needed here;
``clients/examples/ros2`` publishes them.
"""

from __future__ import annotations

import math
from typing import Any

from isodyn_client.bridges.place import GeoFix
from isodyn_client.follow import PlanFix

NO_FIX, FIX = -1, 0
"""NavSatStatus: no position; a position without augmentation."""
COVARIANCE_KNOWN = 3
UNKNOWN_VARIANCE = 1e6
"""m^2, rad^2: of what is not measured at all (height, roll, pitch)."""


def stamp(t: float) -> dict[str, int]:
    """``builtin_interfaces/Time`` of Unix seconds; float64 carries them to a microsecond, and no more is told."""
    sec, micro = divmod(round(t * 1e6), 1_000_000)
    return {"sec": sec, "nanosec": micro * 1000}


def nav_sat_fix(fix: GeoFix, frame_id: str = "isodyn") -> dict[str, Any]:
    """``sensor_msgs/NavSatFix``: covariance in east, north, up, row by row; height is not known (NaN)."""
    nothing = math.nan
    covariance = [
        fix.var_east, fix.cov_east_north, 0.0,
        fix.cov_east_north, fix.var_north, 0.0,
        0.0, 0.0, UNKNOWN_VARIANCE,
    ]  # fmt: skip
    return {
        "header": {"stamp": stamp(fix.t), "frame_id": frame_id},
        "status": {"status": FIX if fix.claimed else NO_FIX, "service": 0},
        "latitude": fix.latitude_deg if fix.claimed else nothing,
        "longitude": fix.longitude_deg if fix.claimed else nothing,
        "altitude": nothing,
        "position_covariance": covariance if fix.claimed else [0.0] * 9,
        "position_covariance_type": COVARIANCE_KNOWN if fix.claimed else 0,
    }


def pose_with_covariance(fix: PlanFix, frame_id: str | None = None) -> dict[str, Any]:
    """``geometry_msgs/PoseWithCovarianceStamped`` on the level: x, y in plan metres, turned to the direction of motion.

    How well that direction is known is not told with a fix: its variance is that of a direction not known at all,
    (2 pi)^2 / 12, and so is the frame's name unless given: the level's id.
    """
    half = math.radians(fix.heading_deg) / 2
    covariance = [0.0] * 36
    covariance[0], covariance[1], covariance[6], covariance[7] = fix.cov_xx, fix.cov_xy, fix.cov_xy, fix.cov_yy
    for i in (2, 3, 4):
        covariance[7 * i] = UNKNOWN_VARIANCE
    covariance[35] = math.pi**2 / 3
    return {
        "header": {"stamp": stamp(fix.t_ms / 1000.0), "frame_id": frame_id or fix.level_id},
        "pose": {
            "pose": {
                "position": {"x": fix.x, "y": fix.y, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
            },
            "covariance": covariance,
        },
    }
