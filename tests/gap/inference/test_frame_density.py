"""Weather whose density differs from frame to frame: its mean is off as a record is, and no entry by itself."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.inference.test_likelihood import search_of, small
from torchweather.gap.inference.frame_density import density_errors, log_density_sd
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.lidar.effects.all import EFFECTS

BANKS, FRAMES = "lidar.patchy_weather", 6
BANKED = ParameterPoint({BANKS: {"log_std": 0.3}})


@pytest.fixture(scope="module")
def null() -> SimulatorLikelihood:
    return search_of(small())


@pytest.mark.parametrize("simulated", [6, 10**9])
def test_the_errors_of_a_mean_are_those_of_drawn_densities(simulated: int) -> None:
    """Of a response with a slope and a curvature, ``a l + b l^2``: 100,000 means of six frames, less one of others."""
    log_sd, slope, curvature = 0.4, np.array([1.0, 0.0, 2.0]), np.array([0.0, 3.0, -1.0])

    def response(log_density: np.ndarray) -> np.ndarray:
        return np.asarray(slope * log_density[..., None] + curvature * log_density[..., None] ** 2)

    low, middle, high = (response(np.array(one)) for one in (-log_sd, 0.0, log_sd))
    first, second = density_errors(FRAMES, simulated, low, middle, high)
    rng = np.random.default_rng(1)
    means = response(log_sd * rng.normal(size=(100_000, FRAMES))).mean(1)
    if simulated == FRAMES:
        means -= response(log_sd * rng.normal(size=(100_000, FRAMES))).mean(1)
    expected = np.outer(first, first) + np.outer(second, second)
    # 100,000 draws know a variance to 0.45 %; some 1 % of one that is a square of normal values.
    np.testing.assert_allclose(np.cov(means.T), expected, atol=0.03 * expected.max())


def test_densities_of_several_effects_are_independent() -> None:
    banks = EFFECTS[BANKS]
    assert log_density_sd([(banks, {"log_std": 0.3}), (banks, {"log_std": 0.4})]) == pytest.approx(0.5)
    assert log_density_sd([(EFFECTS["lidar.window_loss"], {"loss_db": 1.0})]) == 0.0
    assert log_density_sd([]) == 0.0


def test_banks_widen_no_mean_and_are_a_nuisance(null: SimulatorLikelihood) -> None:
    """All means of a frame follow its one density: two nuisances a condition, and their noise is what it was."""
    layout = null.model.layout
    name = null.measured[0].condition.id
    still, banked = null.at(ParameterPoint()), null.at(BANKED)
    used = still.used[name] & banked.used[name]
    means = layout.averages & used
    np.testing.assert_array_equal(banked.sd[name][means], np.minimum(still.sd[name], banked.sd[name])[means])
    assert (banked.sd[name][used & ~means] / still.sd[name][used & ~means]).max() > 1.0
    plain, beside = null.nuisance(ParameterPoint(), still), null.nuisance(BANKED, banked)
    assert beside.response.shape[1] == plain.response.shape[1] + 2 * len(null.measured)
    # The first of them goes as the record does, which is known to 0.05: five densities to 0.3 / sqrt(5), and more.
    record, density = beside.response[:, 0], beside.response[:, -2]
    cosine = record @ density / np.linalg.norm(record) / np.linalg.norm(density)
    assert cosine > 0.85
    assert np.linalg.norm(density) > 2.0 * np.linalg.norm(record)


def test_a_mean_that_few_densities_move_is_no_reason_against_banks(null: SimulatorLikelihood) -> None:
    """A measurement that is denser by a quarter, five times what its record may be off: half as unlikely beside
    banks."""
    denser = null.mean(ParameterPoint({}, {null.measured[0].condition.id: 0.25}))
    off = [new - old for new, old in zip(denser, null.mean(ParameterPoint()), strict=True)]
    left = []
    for point in (BANKED, ParameterPoint()):
        base = null.at(point)
        left.append(null.nuisance(point, base).misfit(null.whitened(base, off)))
    assert left[0] < 0.5 * left[1]
