"""Mie efficiencies against 40-digit series, Bohren & Huffman's and Wiscombe's printed tables, and limits."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.oracles import load
from torchweather.physics import mie_coefficients, mie_efficiencies

GRID = load("mie_grid")["cases"]


@pytest.mark.parametrize("name", GRID)
def test_efficiencies_agree_with_forty_digit_series_from_x_0001_to_30000(name: str) -> None:
    case = GRID[name]
    x = torch.tensor([row["x"] for row in case["rows"]], dtype=torch.float64)
    q = mie_efficiencies(x, complex(*case["m"]))
    for field, key, tolerance in (
        ("q_ext", "qext", 1e-9),
        ("q_sca", "qsca", 1e-9),
        ("g", "g", 1e-9),
        ("q_back", "qback", 1e-5),  # its alternating sum cancels
    ):
        wanted = torch.tensor([row[key] for row in case["rows"]], dtype=torch.float64)
        torch.testing.assert_close(getattr(q, field), wanted, rtol=tolerance, atol=0.0)


def test_bohren_huffman_appendix_a() -> None:
    case = load("mie_bohren_huffman")["appendix_A"]
    q = mie_efficiencies(case["x"], complex(*case["m"]))
    for field, key in (("q_ext", "qext"), ("q_sca", "qsca"), ("q_back", "qback")):
        assert float(getattr(q, field)) == pytest.approx(case["printed"][key], abs=case["tol"])


def test_bohren_huffman_table_of_scattering_coefficients() -> None:
    case = load("mie_bohren_huffman")["table_4_1"]
    a, b = mie_coefficients(case["x"], complex(*case["m"]))
    for mine, exact, printed in ((a, case["a"], case["printed_a"]), (b, case["b"], case["printed_b"])):
        n = len(exact)
        assert torch.allclose(torch.view_as_real(mine[:n]), torch.tensor(exact, dtype=torch.float64), atol=1e-12)
        printed_rows = torch.tensor(printed, dtype=torch.float64)
        assert torch.allclose(torch.view_as_real(mine[: len(printed)]), printed_rows, atol=case["tol"])


@pytest.mark.parametrize("row", load("mie_wiscombe")["rows"], ids=lambda r: f"m={r['m']} x={r['x']}")
def test_wiscombe_1979_printed_cases(row: dict) -> None:
    q = mie_efficiencies(row["x"], complex(*row["m"]))
    for key, field in (("qext", "q_ext"), ("qsca", "q_sca"), ("g", "g")):
        printed = row["printed"].get(key)
        if printed:
            # 6e-6 for seven printed digits; half a unit of the last digit where fewer are printed
            assert float(getattr(q, field)) == pytest.approx(printed, rel=6e-6, abs=5.01e-7)


def test_small_spheres_follow_rayleigh() -> None:
    x, m = 1e-3, 1.5 + 0.1j
    k = (m**2 - 1) / (m**2 + 2)
    q = mie_efficiencies(x, m)
    assert float(q.q_sca) == pytest.approx(8 / 3 * x**4 * abs(k) ** 2, rel=1e-5)  # next order is x^2
    assert float(q.q_ext) == pytest.approx(4 * x * k.imag, rel=1e-5)
    assert float(q.q_back) == pytest.approx(4 * x**4 * abs(k) ** 2, rel=1e-5)


def test_a_transparent_sphere_scatters_all_it_removes() -> None:
    q = mie_efficiencies(torch.logspace(-2, 3, 50, dtype=torch.float64), 1.33)
    torch.testing.assert_close(q.q_ext, q.q_sca, rtol=1e-12, atol=0.0)


def test_a_large_sphere_removes_twice_its_shadow() -> None:
    q = mie_efficiencies(torch.linspace(2.0e4, 2.1e4, 20, dtype=torch.float64), 1.33)
    assert torch.allclose(q.q_ext, torch.tensor(2.0, dtype=torch.float64), atol=0.01)  # edge term x^-2/3


def test_a_sphere_of_index_one_is_invisible() -> None:
    q = mie_efficiencies(5.0, 1.0)
    assert max(float(v) for v in q[:3]) < 1e-20  # rounding squared


def test_sizes_do_not_disturb_each_other() -> None:
    x = torch.tensor([3e3, 1e-3, 7.0, 7.1, 640.0, 0.2], dtype=torch.float64)
    m = 1.33 + 1e-5j
    together = mie_efficiencies(x, m)
    for i, alone in enumerate(x):
        for all_of_them, one in zip(together, mie_efficiencies(alone, m), strict=True):
            assert float(all_of_them[i]) == pytest.approx(float(one), rel=1e-10)


def test_real_and_barely_absorbing_index_agree() -> None:
    x = torch.logspace(-0.3, 2.5, 40, dtype=torch.float64)
    real, complex_path = mie_efficiencies(x, 1.33), mie_efficiencies(x, 1.33 + 1e-15j)
    torch.testing.assert_close(real.q_ext, complex_path.q_ext, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(real.q_back, complex_path.q_back, rtol=1e-7, atol=0.0)


def test_shapes_broadcast_and_may_be_empty() -> None:
    x = torch.rand(4, 1, dtype=torch.float64) + 1.0
    m = torch.tensor([1.33, 1.5 + 0.1j, 3.3 + 1.9j])
    assert mie_efficiencies(x, m).q_ext.shape == (4, 3)
    assert mie_efficiencies(torch.empty(0, 2), 1.33).g.shape == (0, 2)
    assert mie_efficiencies(2.0, 1.33).q_sca.shape == ()
    assert mie_efficiencies(torch.tensor([2.0]), 1.33).q_sca.dtype == torch.float64


def test_numpy_input_is_not_changed() -> None:
    x = torch.tensor([2.0, 1.0], dtype=torch.float64)
    mie_efficiencies(x, 1.33)
    np.testing.assert_array_equal(x.numpy(), [2.0, 1.0])


@pytest.mark.parametrize(
    ("x", "m", "message"),
    [
        (0.0, 1.33, "size_parameter must be above 0"),
        (float("nan"), 1.33, "size_parameter must be above 0"),
        (1e6, 1.33, "size_parameter must lie in"),
        (1.0, 1.33 - 0.1j, "k >= 0"),
    ],
)
def test_bad_arguments_are_named(x: float, m: complex, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        mie_efficiencies(x, m)
