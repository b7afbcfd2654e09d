"""The comparison tests: they keep their level on equal laws, and they go off on laws that differ a little."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom, ks_2samp

from tests.reference.agreement import (
    joint_test,
    ks_critical,
    ks_distance,
    share_z,
    share_z_of_expected,
    z_critical,
)


def test_ks_distance_is_that_of_scipy_with_ties() -> None:
    rng = np.random.default_rng(0)
    a, b = np.round(rng.normal(size=300), 1), np.round(rng.normal(0.2, size=170), 1)
    assert ks_distance(a, b) == pytest.approx(ks_2samp(a, b).statistic, abs=1e-12)
    assert ks_distance([1.0, 2.0], [3.0]) == 1.0
    assert ks_distance([1.0, 2.0], [2.0, 1.0]) == 0.0


def test_ks_critical_value_is_exceeded_at_its_level_under_one_law() -> None:
    rng = np.random.default_rng(1)
    level, n = 0.05, 2000
    alarms = sum(ks_distance(rng.random(400), rng.random(600)) > ks_critical(400, 600, level) for _ in range(n))
    # Binomial; the asymptotic critical value is at most slightly conservative at these sizes.
    assert binom.ppf(1e-4, n, 0.6 * level) <= alarms <= binom.isf(1e-4, n, level)


def test_ks_sees_a_scale_that_is_off_by_five_percent() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.exponential(size=40_000), 1.05 * rng.exponential(size=40_000)
    assert ks_distance(a, b) > ks_critical(a.size, b.size)


def test_ks_refuses_empty_and_not_finite_samples() -> None:
    with pytest.raises(ValueError, match="not empty"):
        ks_distance([], [1.0])
    with pytest.raises(ValueError, match="finite"):
        ks_distance([math.nan], [1.0])


def test_share_z_is_standard_normal_under_one_share() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.binomial(5000, 0.03, 4000), rng.binomial(20_000, 0.03, 4000)
    z = np.array([share_z(int(x), 5000, int(y), 20_000) for x, y in zip(a, b, strict=True)])
    assert abs(z.mean()) < 4.0 / math.sqrt(z.size)
    assert abs(z.std() - 1.0) < 4.0 / math.sqrt(2.0 * z.size)


def test_share_z_sees_shares_that_differ_by_a_tenth() -> None:
    assert abs(share_z(3000, 100_000, 3300, 100_000)) > z_critical()
    assert share_z(0, 10, 0, 10) == 0.0
    assert share_z(10, 10, 10, 10) == 0.0


def test_share_against_its_probability() -> None:
    assert share_z_of_expected(60, 100, 0.5) == pytest.approx(2.0)
    assert share_z_of_expected(0, 100, 0.0) == 0.0
    assert share_z_of_expected(1, 100, 0.0) == math.inf


def test_z_critical_value() -> None:
    assert z_critical(0.05) == pytest.approx(1.959964, abs=1e-6)
    assert z_critical(1e-3) == pytest.approx(3.290527, abs=1e-6)


def echoes(rng: np.random.Generator, n: int, link: float) -> np.ndarray:
    """Two echoes that depend on each other by ``link``; a third of the beams have an object at 28 m."""
    first = rng.normal(size=n)
    second = link * first + math.sqrt(1.0 - link**2) * rng.normal(size=n)
    second[rng.random(n) < 1 / 3] = 28.0
    return np.stack([first, second], axis=1)


def test_joint_test_keeps_its_level_under_one_law() -> None:
    rng = np.random.default_rng(4)
    p = np.array([joint_test(echoes(rng, 3000, 0.5), echoes(rng, 9000, 0.5)).p_value for _ in range(400)])
    # Uniform p values: mean 1/2 and share below 0.05 within 4 standard errors.
    assert abs(p.mean() - 0.5) < 4.0 / math.sqrt(12.0 * p.size)
    assert abs((p < 0.05).mean() - 0.05) < 4.0 * math.sqrt(0.05 * 0.95 / p.size)


def test_joint_test_sees_independent_draws_with_the_right_margins() -> None:
    rng = np.random.default_rng(5)
    a, b = echoes(rng, 20_000, 0.2), echoes(rng, 20_000, 0.0)
    for column in range(2):  # each margin alone shows nothing
        assert ks_distance(a[:, column], b[:, column]) < ks_critical(len(a), len(b))
    assert joint_test(a, b).p_value < 1e-6


def test_joint_test_of_one_constant_column_sees_nothing_to_compare() -> None:
    joint = joint_test(np.ones((50, 1)), np.ones((70, 1)))
    assert (joint.n_free, joint.p_value) == (0, 1.0)
