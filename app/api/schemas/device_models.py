"""Models of devices."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field

from app.api.schemas.base import Out, PageOut, example
from app.api.schemas.devices import CALIBRATION_EXAMPLE, CalibrationOut
from app.engine.calibration import ModelEstimate
from app.services import records

_MODEL = {"name": "OPPO PBCM10", "n_devices": 14}
_TYPICAL: dict[str, Any] = {
    **CALIBRATION_EXAMPLE,
    "offset_sd": [0.8, 0.7, 1.1],
    "stride_scale_sd": 0.02,
    "soft_iron_sd": [0.008, 0.007, 0.02, 0.006, 0.007, 0.007],
}
_ESTIMATE = {
    "n_taught": 9,
    "typical": _TYPICAL,
    "spread": {**CALIBRATION_EXAMPLE, "offset_sd": [2.1, 1.8, 2.6]},
    "start": {**CALIBRATION_EXAMPLE, "offset_sd": [4.2, 4.1, 4.5]},
}


class ModelEstimateOut(Out):
    """What devices of a model have in common, as those used last were found to be; values are the same in all three."""

    model_config = example(_ESTIMATE)

    n_taught: Annotated[int, Field(description="Devices it rests on: the last 32 that taught something.")]
    typical: Annotated[CalibrationOut, Field(description="The model's mean; deviations are those of the mean.")]
    spread: Annotated[CalibrationOut, Field(description="Deviations are those among devices of the model.")]
    start: Annotated[
        CalibrationOut, Field(description="What a new device's first session starts with; deviations are its own.")
    ]

    @classmethod
    def of(cls, estimate: ModelEstimate) -> Self:
        """Show an estimate."""
        return cls(
            n_taught=estimate.n_devices,
            typical=CalibrationOut.of(estimate.typical),
            spread=CalibrationOut.of(estimate.spread),
            start=CalibrationOut.of(estimate.start),
        )


class DeviceModelOut(Out):
    """A model that devices name."""

    model_config = example(_MODEL)

    name: str
    n_devices: Annotated[int, Field(description="Devices that name it.")]

    @classmethod
    def of(cls, model: records.DeviceModel) -> Self:
        """Show a model."""
        return cls(name=model.name, n_devices=model.n_devices)


class DeviceModelDetailOut(DeviceModelOut):
    """A model with what its devices have in common."""

    model_config = example({**_MODEL, "estimate": _ESTIMATE})

    estimate: Annotated[
        ModelEstimateOut | None,
        Field(description="Null while fewer than 3 devices taught something: it would tell of single ones."),
    ]

    @classmethod
    def with_estimate(cls, model: records.DeviceModel) -> Self:
        """Show a model and its estimate."""
        estimate = model.estimate and ModelEstimateOut.of(model.estimate)
        return cls(**DeviceModelOut.of(model).model_dump(), estimate=estimate)


class DeviceModelPage(PageOut):
    """Models, by name."""

    model_config = example({"items": [_MODEL], "next_cursor": None})

    items: list[DeviceModelOut]
