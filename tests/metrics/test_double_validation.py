"""The double validation metric against distributions whose bias and scatter are known."""

from __future__ import annotations

import math

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import Phase, given, settings
from scipy.stats import wasserstein_distance
from torch import Tensor

from torchweather.metrics.double_validation import CENTRES, double_validation

quick = settings(max_examples=60, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])


def sample(n: int, seed: int) -> Tensor:
    return torch.randn(n, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def row(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_two_steps_by_hand() -> None:
    # Without the bias of 10: -2, 2 against -1, 1. The functions differ by 1/2 over -2..-1 and over 1..2.
    found = double_validation(row(8.0, 12.0), row(-1.0, 1.0))
    assert (float(found.bias), float(found.scatter)) == (10.0, 1.0)
    # One value against three: 0 against -3, 0, 3; 1/3 over -3..0 and over 0..3.
    found = double_validation(row(5.0), row(-3.0, 0.0, 3.0))
    assert float(found.bias) == 5.0
    assert float(found.scatter) == pytest.approx(2.0)


def test_median_and_mean_part_on_a_skewed_sample() -> None:
    skewed, even = row(0.0, 0.0, 0.0, 8.0), row(0.0, 0.0, 0.0, 0.0)
    median = double_validation(skewed, even)
    assert (float(median.bias), float(median.scatter)) == (0.0, 2.0)
    mean = double_validation(skewed, even, centre="mean")
    assert (float(mean.bias), float(mean.scatter)) == (2.0, 3.0)  # |-2| x 3/4 + |6| x 1/4
    assert float(double_validation(row(1.0, 2.0, 4.0, 9.0), row(0.0)).bias) == 3.0  # the middle two of four


@quick
@given(n=st.integers(1, 50), m=st.integers(1, 50), seed=st.integers(0, 2**32 - 1), centre=st.sampled_from(CENTRES))
def test_scatter_is_the_area_that_scipy_finds(n: int, m: int, seed: int, centre: str) -> None:
    x, y = 3.0 * sample(n, seed), sample(m, seed + 1)
    found = double_validation(x, y, centre=centre)
    wanted = wasserstein_distance((x - found.bias).numpy(), y.numpy())
    assert float(found.scatter) == pytest.approx(wanted, rel=1e-9, abs=1e-12)
    swapped = double_validation(y, x, centre=centre)
    assert float(swapped.bias) == pytest.approx(-float(found.bias), abs=1e-12)
    assert float(swapped.scatter) == pytest.approx(float(found.scatter), abs=1e-12)
    moved = double_validation(x + 7.0, y, centre=centre)
    assert float(moved.bias) == pytest.approx(float(found.bias) + 7.0, abs=1e-12)
    assert float(moved.scatter) == pytest.approx(float(found.scatter), abs=1e-12)


def test_equal_samples_in_another_order_have_neither() -> None:
    x = sample(1001, 1)
    found = double_validation(x.flip(0), x)
    assert (float(found.bias), float(found.scatter)) == (0.0, 0.0)


def test_normal_distributions() -> None:
    n = 200_000
    found = double_validation(5.0 + 2.0 * sample(n, 2), sample(n, 3))
    # Medians vary by 1.25 sigma / sqrt(n); four of them, of both samples.
    assert float(found.bias) == pytest.approx(5.0, abs=4 * 1.25 * math.sqrt(5.0 / n))
    # The area between N(0, 2) and N(0, 1) is (2 - 1) sqrt(2 / pi).
    assert float(found.scatter) == pytest.approx(math.sqrt(2.0 / math.pi), abs=4 * 1.25 * math.sqrt(5.0 / n))


def test_batch_gives_what_its_elements_give() -> None:
    x, y = sample(60, 4).reshape(2, 3, 10), sample(42, 5).reshape(2, 3, 7)
    together = double_validation(x, y)
    assert together.bias.shape == together.scatter.shape == (2, 3)
    for i in range(2):
        for j in range(3):
            alone = double_validation(x[i, j], y[i, j])
            assert float(alone.bias) == float(together.bias[i, j])
            assert float(alone.scatter) == float(together.scatter[i, j])


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ValueError, match=r"simulated must be a tensor .* of one value or more"):
        double_validation(torch.zeros(0), torch.zeros(3))
    with pytest.raises(ValueError, match="measured must be a finite number"):
        double_validation(torch.zeros(2), torch.tensor([0.0, math.nan]))
    for kind in (torch.bool, torch.complex64):
        with pytest.raises(TypeError, match=f"simulated must hold real numbers; got {kind}"):
            double_validation(torch.zeros(2, dtype=kind), torch.zeros(2))
    with pytest.raises(ValueError, match=r"one batch shape; got \(2, 3\) and \(3, 3\)"):
        double_validation(torch.zeros(2, 3), torch.zeros(3, 3))
    with pytest.raises(ValueError, match="centre must be one of median, mean"):
        double_validation(torch.zeros(2), torch.zeros(2), centre="mode")


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.uint8, torch.int64])
def test_every_type_of_number_is_compared_in_double_precision(dtype: torch.dtype) -> None:
    x, y = (100.0 + 20.0 * sample(600, 8)).to(dtype), (90.0 + 10.0 * sample(600, 9)).to(dtype)
    found, wanted = double_validation(x, y), double_validation(x.double(), y.double())
    assert found.bias.dtype == found.scatter.dtype == torch.float64
    assert (float(found.bias), float(found.scatter)) == (float(wanted.bias), float(wanted.scatter))


def test_numbers_that_single_precision_cannot_tell_apart() -> None:
    large = 2**24
    found = double_validation(torch.tensor([large + 1, large + 3]), torch.tensor([large, large + 1]))
    assert (float(found.bias), float(found.scatter)) == (1.5, 0.5)


def test_whole_numbers_and_gradients() -> None:
    whole = double_validation(torch.tensor([4, 6]), torch.tensor([1, 1]))
    assert (float(whole.bias), float(whole.scatter)) == (4.0, 1.0)
    x = sample(9, 6).requires_grad_()
    assert torch.autograd.gradcheck(lambda v: tuple(double_validation(v, sample(8, 7))), (x,))
