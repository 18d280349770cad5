"""What is known about a device."""

from __future__ import annotations

from dataclasses import dataclass

SOFT_IRON_UNKNOWN = 0.04
"""Standard deviation of an element of a device's soft iron, over devices whose platform calibrates them."""
SixFloats = tuple[float, float, float, float, float, float]
_UNKNOWN_SIX = (SOFT_IRON_UNKNOWN,) * 6


@dataclass(frozen=True, slots=True)
class DeviceCalibration:
    """What earlier sessions taught about a device, with how well it is known.

    Attributes
    ----------
    offset, offset_sd : tuple of three floats, uT
        Hard iron left by the platform's calibration, levelled device frame (forward, left, up).
    stride_scale, stride_scale_sd : float
        Stride of the carrier over that of the stride model.
    soft_iron, soft_iron_sd : tuple of six floats
        Elements forward-forward, left-left, up-up, forward-left, forward-up, left-up of the symmetric matrix ``S``,
        same frame: a true field ``m`` reads ``(I + S) m + offset``. As they are by default, nothing is known of them.
    """

    offset: tuple[float, float, float]
    offset_sd: tuple[float, float, float]
    stride_scale: float
    stride_scale_sd: float
    soft_iron: SixFloats = (0.0,) * 6
    soft_iron_sd: SixFloats = _UNKNOWN_SIX
