"""The shape signature: closed forms, what it is blind to, and its noise."""

from __future__ import annotations

import math

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import Phase, given, settings
from torch import Tensor

from torchweather.metrics.clouds import Region
from torchweather.metrics.shape_signature import sdm, shape_signature, shape_signature_distance, signature_distance

quick = settings(max_examples=40, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])
seeds = st.integers(0, 2**32 - 1)


def cloud(n: int, seed: int, spread_m: tuple[float, float, float] = (20.0, 10.0, 2.0)) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(n, 3, generator=generator, dtype=torch.float64) * torch.tensor(spread_m).double()


def turned(points: Tensor, seed: int) -> Tensor:
    """Another pose of the cloud."""
    generator = torch.Generator().manual_seed(seed)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64)).Q
    return points @ turn + 50.0 * torch.randn(3, generator=generator, dtype=torch.float64)


def test_signature_is_the_inverse_distribution_function_of_all_pairs() -> None:
    points = cloud(60, 1)
    matrix = np.linalg.norm(points.numpy()[:, None] - points.numpy()[None], axis=-1)
    pairs = matrix[np.triu_indices(60, 1)]
    u = (np.arange(4096) + 0.5) / 4096
    wanted = np.quantile(pairs, u, method="inverted_cdf")
    np.testing.assert_allclose(shape_signature(points).numpy(), wanted, rtol=1e-12)


def test_drawn_pairs_give_the_signature_of_all_pairs() -> None:
    points = cloud(1600, 2)  # 1 279 200 pairs, more than 2^20
    everything = torch.pdist(points).sort().values
    wanted = everything[((torch.arange(4096) * 2 + 1) * len(everything)) // 8192]
    # 2^20 draws: an expected area of about 0.6 standard deviations / 2^10 between the two functions.
    apart = (shape_signature(points) - wanted).abs().mean() / wanted.mean()
    assert 0.0 < float(apart) < 2e-3


def test_no_point_is_paired_with_itself() -> None:
    # On a circle of N points the least distance of two is 2 sin(pi/N), never 0.
    angle = torch.arange(2000).double() * (2.0 * math.pi / 2000)
    circle = torch.stack((angle.cos(), angle.sin(), torch.zeros_like(angle)), 1)
    signature = shape_signature(circle)
    assert float(signature[0]) >= 2.0 * math.sin(math.pi / 2000) * (1.0 - 1e-9)
    # The chord's quantile function is 2 sin(pi u / 2), its mean 4/pi; 2^20 draws of standard deviation 0.62.
    assert float(signature.mean()) == pytest.approx(4.0 / math.pi, abs=4 * 0.62 / 1024)


@quick
@given(a=st.floats(0.01, 100.0), b=st.floats(0.01, 100.0))
def test_two_points_against_two(a: float, b: float) -> None:
    first, second = (torch.tensor([[1.0, 2.0, 3.0], [1.0, 2.0 + d, 3.0]], dtype=torch.float64) for d in (a, b))
    # W = |a - b|, so 2 |a - b| / (a + b + |a - b|) = 1 - min / max.
    assert float(sdm(first, second)) == pytest.approx(1.0 - min(a, b) / max(a, b), rel=1e-9, abs=1e-12)


@quick
@given(n=st.integers(2, 80), m=st.integers(2, 80), scale=st.floats(0.01, 100.0), seed=seeds)
def test_blind_to_pose_order_and_joint_scale(n: int, m: int, scale: float, seed: int) -> None:
    p, r = cloud(n, seed), cloud(m, seed + 1, (5.0, 5.0, 5.0))
    score = float(sdm(p, r))
    assert 0.0 <= score <= 1.0
    # 1e-9: coordinates of 1e2 m in float64.
    assert float(sdm(turned(p, seed), r)) == pytest.approx(score, abs=1e-9)
    assert float(sdm(p.flip(0), r)) == pytest.approx(score, abs=1e-12)
    assert float(sdm(scale * p, scale * r)) == pytest.approx(score, abs=1e-12)
    assert float(sdm(r, p)) == pytest.approx(score, abs=1e-12)


@quick
@given(n=st.integers(1, 40), m=st.integers(1, 40), k=st.integers(1, 40), seed=seeds)
def test_triangle_inequality(n: int, m: int, k: int, seed: int) -> None:
    spreads = torch.rand(3, 3, generator=torch.Generator().manual_seed(seed)).tolist()
    a, b, c = (shape_signature(cloud(s, seed + i, tuple(spreads[i]))) for i, s in enumerate((n, m, k)))
    ab, bc, ac = (float(signature_distance(*pair)) for pair in ((a, b), (b, c), (a, c)))
    assert ac <= ab + bc + 1e-12


def test_drawn_pairs_are_blind_to_pose_and_scale() -> None:
    p, r = cloud(5000, 3), cloud(4000, 4, (5.0, 5.0, 5.0))
    score = float(sdm(p, r))
    assert float(sdm(turned(p, 1), r)) == pytest.approx(score, abs=1e-9)
    assert float(sdm(3.0 * p, 3.0 * r)) == pytest.approx(score, abs=1e-9)
    assert float(sdm(p, p)) == 0.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_level_of_no_difference(seed: int) -> None:
    whole = cloud(20_000, 5)
    shuffled = whole[torch.randperm(20_000, generator=torch.Generator().manual_seed(seed))]
    # Two draws of 2^20 pairs, spread about 0.6 of the mean: 0.6 sqrt(2) / 2^10 = 0.0008 is one standard deviation.
    assert 0.0 < float(sdm(shuffled, whole, seed=seed)) < 0.0025
    # Half of the points: their own mean distance varies by about 1 / sqrt(10 000) / 2 as well.
    assert 0.0 < float(sdm(shuffled[:10_000], whole, seed=seed)) < 0.0125


def test_a_veil_near_the_sensor_is_far_above_that_level() -> None:
    scene = cloud(20_000, 6)
    veil = scene.clone()
    veil[::5] *= 0.1
    assert float(sdm(veil, scene)) > 0.05


def test_clouds_without_a_shape() -> None:
    proper, one, none = cloud(50, 7), cloud(1, 8), torch.zeros(0, 3, dtype=torch.float64)
    together = one.expand(20, 3)
    for shapeless in (one, none, together):
        assert float(sdm(shapeless, proper)) == float(sdm(proper, shapeless)) == 1.0
        assert float(sdm(shapeless, one)) == 0.0


def test_seed_and_region_and_batch() -> None:
    p, r = cloud(3000, 9), cloud(2000, 10)
    assert float(sdm(p, r, seed=1)) == float(sdm(p, r, seed=1)) != float(sdm(p, r, seed=2))
    region = Region(y_m=(0.0, 30.0))
    cut = [c[(c[:, 1] >= 0.0) & (c[:, 1] <= 30.0)] for c in (p, r)]
    assert float(sdm(p, r, region=region)) == float(sdm(*cut))
    both = shape_signature_distance([p, r], [r, p])
    assert both.tolist() == [float(sdm(p, r)), float(sdm(r, p))]
    assert sdm(p.float(), r.float()).dtype == torch.float32


def test_pairs_drawn_in_inference_mode_do_not_stop_later_gradients() -> None:
    p = cloud(2011, 13)  # a size of its own: its pairs are drawn in inference mode
    with torch.inference_mode():
        first = float(sdm(p, 1.1 * p))
    moving = p.clone().requires_grad_()
    found = sdm(moving, 1.1 * p)
    assert float(found.detach()) == first
    assert bool(torch.autograd.grad(found, moving)[0].any())


def test_gradient_is_finite_with_drawn_pairs_too() -> None:
    p, r = cloud(1500, 11).requires_grad_(), cloud(1500, 12)
    for other in (r, p.detach()):
        (gradient,) = torch.autograd.grad(sdm(p, other), p)
        assert bool(torch.isfinite(gradient).all())
    assert float(torch.autograd.grad(sdm(p, r), p)[0].abs().sum()) > 0.0
