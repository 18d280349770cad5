"""The drift of an inertial navigation system is that of the closed form, and its covariance is true."""

from __future__ import annotations

import numpy as np
import pytest

from app.evaluation.papers.ins import DEG_PER_H, EARTH_RADIUS_M, GRAVITY, InertialErrors, simulate_drift

T = np.arange(0.0, 1800.5)
SCHULER = np.sqrt(GRAVITY / EARTH_RADIUS_M)
EAST = np.zeros(len(T))
SPEED = np.full(len(T), 10.0)


def size(errors: InertialErrors) -> np.ndarray:
    """Magnitude of the drift on each axis: the one error has a random sign."""
    return np.abs(simulate_drift(errors, T, EAST, SPEED, np.random.default_rng(0)).xy)


def test_a_bias_swings_with_schulers_period() -> None:
    drift = size(InertialErrors(gyro_drift_deg_h=0.0, accelerometer_bias=5e-4))
    exact = 5e-4 / SCHULER**2 * (1.0 - np.cos(SCHULER * T))
    np.testing.assert_allclose(drift, np.stack([exact, exact], axis=1), rtol=0.01, atol=0.5)


def test_gyro_drift_grows_with_time() -> None:
    drift = size(InertialErrors(gyro_drift_deg_h=0.005, accelerometer_bias=0.0))
    exact = EARTH_RADIUS_M * 0.005 * DEG_PER_H * (T - np.sin(SCHULER * T) / SCHULER)
    np.testing.assert_allclose(drift, np.stack([exact, exact], axis=1), rtol=0.01, atol=0.5)


def test_velocity_and_tilt_at_the_start() -> None:
    none = {"gyro_drift_deg_h": 0.0, "accelerometer_bias": 0.0}
    swing = np.sin(SCHULER * T) / SCHULER
    np.testing.assert_allclose(
        size(InertialErrors(**none, velocity=0.1))[:, 0], 0.1 * np.abs(swing), rtol=0.01, atol=0.2
    )
    tilted = GRAVITY * 1e-4 / SCHULER**2 * (1.0 - np.cos(SCHULER * T))
    np.testing.assert_allclose(size(InertialErrors(**none, tilt=1e-4))[:, 1], tilted, rtol=0.01, atol=0.5)


def test_a_heading_error_matters_where_the_vehicle_turns() -> None:
    errors = InertialErrors(gyro_drift_deg_h=0.0, accelerometer_bias=0.0, heading=0.01)
    assert size(errors).max() < 1e-9
    turned = np.where(T > 600.0, np.pi / 2, 0.0)
    drift = simulate_drift(errors, T, turned, SPEED, np.random.default_rng(0))
    # the change of velocity is resolved in axes turned by 0.01 rad: 0.14 m/s from there on
    assert np.hypot(*drift.xy[900]) == pytest.approx(0.1 * np.sqrt(2.0) * 300.0, rel=0.05)


def test_no_errors_no_drift() -> None:
    drift = simulate_drift(InertialErrors(0.0, 0.0), T, EAST, SPEED, np.random.default_rng(0))
    assert not drift.xy.any()
    assert not drift.heading.any()
    assert not drift.cov.any()


def test_the_covariance_is_that_of_the_draws() -> None:
    errors = InertialErrors(0.03, 0.01, accelerometer_noise=0.05, velocity=0.1, tilt=0.001, heading=0.01)
    t = np.arange(0.0, 20.0, 0.1)
    course = 0.5 * np.sin(t)
    rng = np.random.default_rng(1)
    draws = [simulate_drift(errors, t, course, np.ones(len(t)), rng) for _ in range(300)]
    ends = np.array([draw.xy[-1] for draw in draws])
    np.testing.assert_allclose(ends.T @ ends / len(ends), draws[0].cov[-1], atol=0.2 * draws[0].cov[-1].max())
    assert abs(draws[0].heading[0]) == pytest.approx(0.01)


def test_the_same_generator_draws_the_same() -> None:
    errors = InertialErrors(0.03, 0.01, accelerometer_noise=0.05)
    a, b = (simulate_drift(errors, T, EAST, SPEED, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(a.xy, b.xy)
