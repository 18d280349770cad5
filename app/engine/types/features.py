"""Feature sets: what of the field is compared."""

from __future__ import annotations

from enum import StrEnum


class FeatureSet(StrEnum):
    """What of the field is compared with the map."""

    VECTOR = "vector"
    HV = "hv"
    TOTAL = "total"

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in storage order."""
        return _CHANNELS[self]


_CHANNELS: dict[FeatureSet, tuple[str, ...]] = {
    FeatureSet.VECTOR: ("x", "y", "z"),
    FeatureSet.HV: ("h", "v"),
    FeatureSet.TOTAL: ("total",),
}
