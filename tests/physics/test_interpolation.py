"""The table over the intensity: accuracy, ends, gradients, export."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.physics import (
    InterpolationTable,
    default_fog,
    extinction_from_mor,
    extinction_per_m,
    marshall_palmer,
    rain_attenuation_p838_db_per_km,
    sekhon_srivastava,
)

HALF_A_PERCENT = 0.005  # DESIGN.md 2


def _between_nodes(low: float, high: float) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.exp(torch.empty(400, dtype=torch.float64).uniform_(math.log(low), math.log(high), generator=generator))


@pytest.mark.parametrize(
    ("function", "low", "high"),
    [
        (lambda rate: marshall_palmer(rate).moment(2.0), 0.1, 300.0),
        (lambda rate: marshall_palmer(rate).tail_per_m3(torch.tensor([0.5, 1.0, 2.0])), 0.1, 300.0),
        (lambda rate: extinction_per_m(sekhon_srivastava(rate), 905.0), 0.05, 20.0),
        (lambda mor: extinction_per_m(default_fog(mor), 905.0), 5.0, 5000.0),
        (rain_attenuation_p838_db_per_km, 0.1, 300.0),
    ],
    ids=["rain cross-section", "rain tail", "snow at 905 nm", "fog at 905 nm", "P.838"],
)
def test_coefficients_of_the_users_are_within_half_a_percent(function, low: float, high: float) -> None:
    table = InterpolationTable(function, low, high, 96)
    intensity = _between_nodes(low, high)
    error = (table(intensity) / function(intensity) - 1.0).abs().max()
    assert float(error) < HALF_A_PERCENT


def test_a_power_law_is_exact_and_goes_on_outside() -> None:
    table = InterpolationTable(lambda rate: 3.0 * rate**0.7, 1.0, 100.0, 5)
    intensity = torch.tensor([0.01, 1.0, 7.7, 100.0, 5000.0], dtype=torch.float64)
    torch.testing.assert_close(table(intensity), 3.0 * intensity**0.7, rtol=1e-12, atol=0.0)


def test_linear_values_hold_their_ends() -> None:
    table = InterpolationTable(lambda rate: torch.log(rate), 1.0, 100.0, 5, log_values=False)
    got = table(torch.tensor([0.1, 1.0, 10.0, 1e4], dtype=torch.float64))
    torch.testing.assert_close(got, torch.tensor([0.0, 0.0, math.log(10.0), math.log(100.0)], dtype=torch.float64))


def test_no_rain_and_unlimited_visibility_are_exactly_zero_with_finite_gradients() -> None:
    rain = InterpolationTable(lambda rate: 1e-3 * rate**0.6, 0.1, 100.0, 8, zero_at_zero=True)
    fog = InterpolationTable(extinction_from_mor, 5.0, 5000.0, 8, zero_at_inf=True)
    for table, intensity in ((rain, [0.0, 5.0]), (fog, [math.inf, 50.0])):
        x = torch.tensor(intensity, requires_grad=True)
        value = table(x)
        assert float(value[0].detach()) == 0.0
        assert float(value[1].detach()) > 0.0
        (gradient,) = torch.autograd.grad(value.sum(), x)
        assert bool(torch.isfinite(gradient).all())
        assert float(gradient[0]) == 0.0


def test_nan_stays_nan() -> None:
    table = InterpolationTable(lambda rate: rate, 0.1, 100.0, 8, zero_at_zero=True)
    assert bool(torch.isnan(table(torch.tensor(math.nan))))


def test_gradient_is_that_of_the_function() -> None:
    table = InterpolationTable(lambda rate: torch.stack([rate**0.5, 2.0 * rate], -1), 0.1, 100.0, 64)
    intensity = torch.tensor([0.33, 7.7], dtype=torch.float64, requires_grad=True)  # away from the nodes
    assert torch.autograd.gradcheck(table, intensity)


def test_values_may_have_any_shape_and_dtype_follows_the_intensity() -> None:
    table = InterpolationTable(lambda rate: rate[:, None, None] * torch.ones(2, 3, dtype=torch.float64), 0.1, 10.0, 8)
    assert table(torch.ones(5, 4)).shape == (5, 4, 2, 3)
    assert table(torch.ones(())).shape == (2, 3)
    assert table(torch.ones(2)).dtype == torch.float32
    assert table(torch.ones(2, dtype=torch.float64)).dtype == torch.float64
    assert list(table.state_dict()) == ["values"]
    assert not list(table.parameters())


@pytest.mark.slow
def test_exported_table_gives_the_same_numbers(tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    table = InterpolationTable(
        lambda r: marshall_palmer(r).tail_per_m3(torch.tensor([0.5, 1.0])), 0.1, 300.0, 64, zero_at_zero=True
    )
    path = tmp_path / "table.onnx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecation notices
        torch.onnx.export(
            table, (torch.tensor([1.0, 2.0]),), path, dynamo=True, verbose=False, dynamic_shapes=({0: "batch"},)
        )
    session = onnxruntime.InferenceSession(path)
    intensity = torch.tensor([0.0, 0.05, 1.0, 25.0, 700.0])
    (got,) = session.run(None, {session.get_inputs()[0].name: intensity.numpy()})
    np.testing.assert_allclose(got, table(intensity).numpy(), rtol=2e-5)  # float32 graph


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"low": 0.0, "high": 1.0}, "low must be above 0"),
        ({"low": 2.0, "high": 1.0}, "low < high"),
        ({"low": 1.0, "high": 2.0, "n": 1}, "n must lie in 2.."),
    ],
)
def test_bad_ranges_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        InterpolationTable(lambda rate: rate, **arguments)


def test_values_without_a_logarithm_are_refused() -> None:
    with pytest.raises(ValueError, match="log_values=False"):
        InterpolationTable(lambda rate: rate - 1.0, 1.0, 2.0, 4)
