"""The film on a cover: against a step by step calculation in plain Python, and its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.physics import wet_cover_loss_db, wet_cover_series_db

VALUES = {"loss_db": 0.3, "film_db": 0.8, "film_exponent": 0.4, "drying_min": 7.0}


def by_steps(rain: np.ndarray, time_min: np.ndarray) -> np.ndarray:
    """The wetness of the step before dries, or the rain of now makes more."""
    found, wet = [], 0.0
    for number, rate in enumerate(rain):
        if number:
            wet *= math.exp(-(time_min[number] - time_min[number - 1]) / VALUES["drying_min"])
        wet = max(wet, rate ** VALUES["film_exponent"] if rate > 0 else 0.0)
        found.append(VALUES["loss_db"] + VALUES["film_db"] * wet)
    return np.array(found)


@pytest.fixture
def series() -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(3)
    time_min = np.cumsum(generator.uniform(0.2, 5.0, 300))
    rain = generator.exponential(10.0, 300) * (generator.random(300) < 0.3)
    return rain, time_min


def test_a_series_is_what_steps_in_time_make_of_it(series: tuple[np.ndarray, np.ndarray]) -> None:
    rain, time_min = (torch.from_numpy(values) for values in series)
    got = wet_cover_series_db(rain, time_min, **VALUES)
    np.testing.assert_allclose(got.numpy(), by_steps(*series), rtol=1e-12)
    many = wet_cover_series_db(torch.stack([rain, 0.0 * rain]), time_min, **VALUES)
    assert torch.equal(many[0], got)
    assert torch.equal(many[1], torch.full_like(got, VALUES["loss_db"]))


def test_now_is_the_last_of_the_series(series: tuple[np.ndarray, np.ndarray]) -> None:
    rain, time_min = (torch.from_numpy(values[:60]) for values in series)
    now = wet_cover_loss_db(rain, time_min[-1] - time_min, **VALUES)
    assert float(now) == pytest.approx(by_steps(*(values[:60] for values in series))[-1], rel=1e-12)


def test_single_precision_lasts_for_a_month_of_minutes() -> None:
    """The elapsed time over the drying time is 43,000 at the end; its sum with the wetness is in double precision."""
    time_min = torch.arange(43_200.0)
    rain = torch.zeros_like(time_min)
    rain[-3] = 8.0
    got = wet_cover_series_db(rain, time_min, 0.0, 1.0, 1.0 / 3.0, 1.0)[-3:]
    torch.testing.assert_close(got, 2.0 * torch.exp(-torch.arange(3.0)), rtol=1e-6, atol=0.0)


def test_after_one_drying_time_one_over_e_is_left() -> None:
    wet = wet_cover_loss_db(torch.tensor([30.0]), torch.tensor([7.0]), **VALUES)
    assert float(wet) - 0.3 == pytest.approx(0.8 * 30.0**0.4 / math.e, rel=1e-5)


def test_no_rain_leaves_the_constant_and_a_gradient_without_a_hole() -> None:
    rain = torch.tensor([0.0, 0.0], requires_grad=True)
    film = torch.tensor(0.0, requires_grad=True)
    loss = wet_cover_loss_db(rain, torch.tensor([0.0, 5.0]), 0.3, film, 0.4, 7.0)
    loss.backward()
    assert float(loss.detach()) == pytest.approx(0.3)
    assert rain.grad is not None
    assert film.grad is not None
    assert rain.grad.tolist() == [0.0, 0.0]
    assert float(film.grad) == 0.0


def test_gradients_are_those_of_finite_differences() -> None:
    rain = torch.tensor([[4.0, 9.0, 0.0], [20.0, 0.0, 0.0]], dtype=torch.float64, requires_grad=True)
    time_min = torch.tensor([0.0, 2.0, 7.0], dtype=torch.float64)
    values = [torch.tensor([value, 1.3 * value], dtype=torch.float64, requires_grad=True) for value in VALUES.values()]

    def series(rates: torch.Tensor, *given: torch.Tensor) -> torch.Tensor:
        return wet_cover_series_db(rates, time_min, *given)

    def now(rates: torch.Tensor, *given: torch.Tensor) -> torch.Tensor:
        return wet_cover_loss_db(rates, time_min.flip(0).expand(2, 3), *given)

    rates = (rain.detach() + 0.5).requires_grad_()
    assert torch.autograd.gradcheck(series, (rates, *values))
    assert torch.autograd.gradcheck(now, (rates, *values))
