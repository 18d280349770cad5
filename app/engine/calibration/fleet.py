"""What devices of one model have in common: a random-effects estimate over what each of them was found to be.

A device's offset is its model's mean and a deviation of its own; the model's mean and the spread among its devices are
unknown too. The spread is integrated out over a grid, the mean given a spread is Gaussian (Gelman et al., Bayesian Data
Analysis, 3rd ed. 2013, section 5.4). What differs here: a device may be odd (a magnetic case, a broken sensor), so each
counts by how likely it is like its siblings (a mixture, solved by expectation and maximization), and the priors share
out what is known of *any* device between models and devices of one model, so that a model nobody has seen gives just
that again.

Memories hold what is known of any device as their prior. It is taken out of each before they are compared
(:func:`own_evidence`), or every model would look like every other; and a device's own start is its own evidence with
its model as the prior (:func:`with_model`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.calibration.memory import MemoryLaw
from app.engine.types import DeviceCalibration, Float64Array

_LAW = MemoryLaw()
_N = 10
"""Components: offset (3), stride, soft iron (6)."""
_CENTRE = np.array([0.0, 0.0, 0.0, 1.0, *(0.0,) * 6])
_ROUNDS = 8
_LEAST_INFORMATION = 0.02
"""Of the prior's: a memory that tells less has no evidence of its own, only rounding."""


@dataclass(frozen=True, slots=True)
class FleetLaw:
    """What is believed of models before any device was seen; in units of what is known of any device.

    Attributes
    ----------
    model_share : float
        Share of the variance over all devices that lies between models; the rest lies between devices of one model.
        Half: nothing is known of it.
    odd_share, odd_sd : float
        So many devices are not like their siblings, and how they are: by so many times the standard deviation over all
        devices. (Of 50 phones and epochs on six recorded floors 3 were off by 11 to 44 uT, the others by some 3 uT.) A
        new device may be one of them, so none starts surer than this allows (0.67 of the standard deviation over all
        devices): a tracker that believes its start too much never finds an odd device's offset.
    spreads : int
        Points of the grid of spreads.
    """

    model_share: float = 0.5
    odd_share: float = 0.05
    odd_sd: float = 3.0
    spreads: int = 16


_FLEET = FleetLaw()


@dataclass(frozen=True, slots=True)
class ModelEstimate:
    """What a model's devices have in common.

    Attributes
    ----------
    n_devices : int
        Devices with evidence of their own that it rests on.
    typical : DeviceCalibration
        The model's mean, with standard deviations of the mean.
    spread : DeviceCalibration
        The same values, with the standard deviation *among devices* of the model in place of the mean's.
    start : DeviceCalibration
        What is known of a device of the model never seen: the same values, less certain by both, and by how odd one may
        be.
    """

    n_devices: int
    typical: DeviceCalibration
    spread: DeviceCalibration
    start: DeviceCalibration


def own_evidence(memory: DeviceCalibration, law: MemoryLaw = _LAW) -> tuple[Float64Array, Float64Array]:
    """What a device's memory holds beyond what is known of any device.

    Returns
    -------
    value, information : arrays, shape (10,)
        Offset (uT), stride, soft iron, and how much is known of each (one over the variance); 0 where the device taught
        nothing.
    """
    prior = _wide(law) ** -2
    values, precision = _values(memory), np.maximum(_sds(memory), _floors(law)) ** -2
    information = np.where(precision - prior > _LEAST_INFORMATION * prior, precision - prior, 0.0)
    gained = values * precision - _CENTRE * prior
    return np.where(information > 0.0, gained / np.where(information > 0.0, information, 1.0), _CENTRE), information


def estimate_model(
    memories: Sequence[DeviceCalibration], law: MemoryLaw = _LAW, fleet: FleetLaw = _FLEET
) -> ModelEstimate:
    """Mean and spread of a model from the memories of its devices, one a device.

    Parameters
    ----------
    memories : sequence of DeviceCalibration
        May be empty: then ``start`` is what is known of any device.

    Notes
    -----
    Components are estimated one by one: what the axes of a magnetometer have in common is not known.
    """
    evidence = [own_evidence(memory, law) for memory in memories]
    told = [pair for pair in evidence if pair[1].any()]
    scale = _wide(law)
    y = np.array([(value - _CENTRE) / scale for value, _ in told]).reshape(-1, _N)
    information = np.array([known * scale**2 for _, known in told]).reshape(-1, _N)
    mean, mean_sd, spread, start_sd = _posterior(y, information, fleet)
    values = _CENTRE + scale * mean
    # a model is not known better than one of its sessions is believed, as is nothing else
    known_sd = np.maximum(scale * start_sd, _floors(law))
    return ModelEstimate(
        n_devices=len(told),
        typical=_calibration(values, scale * mean_sd),
        spread=_calibration(values, scale * spread),
        start=_calibration(values, known_sd),
    )


def with_model(memory: DeviceCalibration, start: DeviceCalibration, law: MemoryLaw = _LAW) -> DeviceCalibration:
    """What is known of a device when its model is known too: its own evidence, and for the rest its model.

    Parameters
    ----------
    memory : DeviceCalibration
        Of the device, drift included.
    start : DeviceCalibration
        What is known of a device of its model (:attr:`ModelEstimate.start`), from *other* devices.
    """
    value, information = own_evidence(memory, law)
    prior = _sds(start) ** -2
    known = prior + information
    return _calibration((_values(start) * prior + value * information) / known, np.maximum(known**-0.5, _floors(law)))


def _posterior(
    y: Float64Array, information: Float64Array, fleet: FleetLaw
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Mean, its deviation, spread, and deviation of a new device, shape (10,) each; all in units of any device's.

    ``y`` and ``information`` have shape (devices, 10). For each spread of the grid the mean is found with the
    devices' weights; the grid's points are then weighed by their likelihood (Laplace's approximation in the mean).
    """
    model_variance, spread_variance = fleet.model_share, 1.0 - fleet.model_share
    tau = np.linspace(0.0, 3.0, fleet.spreads + 1)[1:] * np.sqrt(spread_variance)
    noise = np.where(information > 0.0, 1.0 / np.where(information > 0.0, information, 1.0), np.inf)
    alike = tau[:, None, None] ** 2 + noise  # (spreads, devices, 10)
    odd = fleet.odd_sd**2 + alike
    precision = 1.0 / alike
    mean = np.zeros((len(tau), _N))
    share = np.ones_like(alike)
    for _ in range(_ROUNDS):
        weight = share * precision
        known = weight.sum(axis=1) + 1.0 / model_variance
        mean = (weight * y).sum(axis=1) / known
        log_alike, log_odd = _log_densities(y, mean[:, None], alike, odd, fleet.odd_share)
        share = 1.0 / (1.0 + np.exp(log_odd - log_alike))
    log_likelihood = np.where(np.isfinite(alike), np.logaddexp(log_alike, log_odd), 0.0).sum(axis=1)
    log_weight = log_likelihood - 0.5 * mean**2 / model_variance - 0.5 * np.log(known)
    log_weight -= 0.5 * tau[:, None] ** 2 / spread_variance  # half-normal prior of the spread
    weight_of = np.exp(log_weight - log_weight.max(axis=0))
    weight_of /= weight_of.sum(axis=0)
    centre = (weight_of * mean).sum(axis=0)
    mean_variance = (weight_of * (1.0 / known + (mean - centre) ** 2)).sum(axis=0)
    spread = (weight_of * tau[:, None]).sum(axis=0)
    alone = mean_variance + (weight_of * tau[:, None] ** 2).sum(axis=0)
    new = (1.0 - fleet.odd_share) * alone + fleet.odd_share * fleet.odd_sd**2
    return centre, np.sqrt(mean_variance), spread, np.minimum(np.sqrt(new), 1.0)


def _log_densities(
    y: Float64Array, mean: Float64Array, alike: Float64Array, odd: Float64Array, odd_share: float
) -> tuple[Float64Array, Float64Array]:
    """Log densities, but for a constant, of devices as siblings and as odd ones; a device that tells nothing: equal."""
    told = np.isfinite(alike)
    square = (y - mean) ** 2
    log_alike = np.log(1.0 - odd_share) - 0.5 * (square / alike + np.log(np.where(told, alike, 1.0)))
    log_odd = np.log(odd_share) - 0.5 * (square / odd + np.log(np.where(told, odd, 1.0)))
    return log_alike, log_odd


def _values(known: DeviceCalibration) -> Float64Array:
    return np.array([*known.offset, known.stride_scale, *known.soft_iron])


def _sds(known: DeviceCalibration) -> Float64Array:
    return np.array([*known.offset_sd, known.stride_scale_sd, *known.soft_iron_sd])


def _wide(law: MemoryLaw) -> Float64Array:
    return np.array([*(law.offset_wide,) * 3, law.stride_wide, *(law.soft_iron_wide,) * 6])


def _floors(law: MemoryLaw) -> Float64Array:
    return np.array([*(law.offset_floor,) * 3, law.stride_floor, *(law.soft_iron_floor,) * 6])


def _calibration(values: Float64Array, sds: Float64Array) -> DeviceCalibration:
    (x, y, z, stride, *iron), (sx, sy, sz, stride_sd, *iron_sd) = values.tolist(), sds.tolist()
    return DeviceCalibration((x, y, z), (sx, sy, sz), stride, stride_sd, tuple(iron), tuple(iron_sd))
