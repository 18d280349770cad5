"""Recorded walks: what every reader gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.types import Float64Array, ImuSamples, RadioScans, SurveyWalk, Waypoints


@dataclass(frozen=True, slots=True)
class RadioLog:
    """Wi-Fi or BLE readings of a walk with the time at which the phone reported them.

    Attributes
    ----------
    scans : RadioScans
        ``scans.t`` is when the readings hold, as well as the source tells.
    reported_t : array, shape (m,), s
        When the scan was delivered, non-decreasing. A causal replay may use a row only from here on.
    """

    scans: RadioScans
    reported_t: Float64Array

    def between(self, after: float, until: float) -> RadioScans | None:
        """Readings reported in ``(after, until]``, None if there are none."""
        first, last = np.searchsorted(self.reported_t, [after, until], side="right")
        if first == last:
            return None
        rows = slice(int(first), int(last))
        return RadioScans(self.scans.t[rows], self.scans.address[rows], self.scans.rssi[rows])


@dataclass(frozen=True, slots=True)
class RecordedWalk:
    """One recorded walk with labelled waypoints.

    Attributes
    ----------
    walk_id : str
    split : str
        What the walk is for: ``train`` or ``test``, or the data set's own word.
    samples : ImuSamples
    waypoints : Waypoints
    wifi_log, ble_log : RadioLog or None
    device : str
        Brand and model, empty if unknown.
    path_length_m : float
        Sum of the straight legs between the waypoints.
    device_heading : float or None, rad, level frame
        As in :class:`app.engine.types.SurveyWalk`.
    calibration_epoch : str
        Names the phone and the epoch of its magnetometer's own calibration; empty if unknown.
    even_pace : bool
        Truth between the labels runs linearly in time, because the source says so; else in steps.
    """

    walk_id: str
    split: str
    samples: ImuSamples
    waypoints: Waypoints
    wifi_log: RadioLog | None
    device: str
    path_length_m: float
    device_heading: float | None = None
    even_pace: bool = False
    ble_log: RadioLog | None = None
    calibration_epoch: str = ""

    @property
    def wifi(self) -> RadioScans | None:
        """All Wi-Fi readings of the walk."""
        return self.wifi_log.scans if self.wifi_log else None

    @property
    def ble(self) -> RadioScans | None:
        """All BLE readings of the walk."""
        return self.ble_log.scans if self.ble_log else None

    def survey_walk(self) -> SurveyWalk:
        """The walk as input of map building."""
        return SurveyWalk(self.walk_id, self.samples, self.waypoints, self.wifi, self.device_heading, self.ble)


def path_length(waypoints: Waypoints) -> float:
    """Sum of the straight legs, m."""
    return float(np.hypot(np.diff(waypoints.x), np.diff(waypoints.y)).sum())
