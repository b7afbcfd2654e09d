"""Cloud scores against a naive N x N reference, their inequalities, closed forms, and clouds that are hardly there."""

from __future__ import annotations

import math
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import Phase, given, settings
from torch import Tensor

from torchweather.metrics import nearest
from torchweather.metrics.cloud_scores import (
    CLOUD_SCORES,
    chamfer_distance,
    cloud_scores,
    hausdorff_distance,
    hausdorff_distance_95,
    max_mean_distance_error,
    mean_distance_error,
    root_mean_square_error,
)
from torchweather.metrics.clouds import FARTHEST_M, Region
from torchweather.metrics.nearest import nearest_distances
from torchweather.metrics.shape_signature import shape_signature_distance

quick = settings(max_examples=60, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 60)
FAR = ("rmse", "mde", "mmde", "hd", "hd95")
ALL = (*CLOUD_SCORES, "chamfer", "chamfer_squared")


def cloud(n: int, seed: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype) * 10.0


def naive(p: Tensor, r: Tensor) -> dict[str, float]:
    """All scores of distances from the full matrix, in numpy."""
    matrix = np.linalg.norm(p.numpy()[:, None] - r.numpy()[None], axis=-1)
    forth, back = matrix.min(1), matrix.min(0)
    both = np.concatenate((forth, back))
    return {
        "rmse": float(np.sqrt((both**2).mean())),
        "mde": float(both.mean()),
        "mmde": float(max(forth.mean(), back.mean())),
        "hd": float(max(forth.max(), back.max())),
        "hd95": float(max(np.percentile(forth, 95), np.percentile(back, 95))),
        "chamfer": float(forth.mean() + back.mean()),
        "chamfer_squared": float((forth**2).mean() + (back**2).mean()),
    }


def values(scores: dict[str, Tensor]) -> dict[str, float]:
    return {name: float(score) for name, score in scores.items()}


@pytest.mark.parametrize("search", ["tree", "exhaustive"])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 30), (40, 40), (150, 77)])
def test_scores_are_those_of_the_full_matrix(n: int, m: int, search: str) -> None:
    p, r = cloud(n, 1), cloud(m, 2)
    found = values(cloud_scores(p, r, names=ALL, search=search))
    del found["sdm"]
    assert found == pytest.approx(naive(p, r), rel=1e-12)


def test_single_scores_are_those_of_the_set() -> None:
    p, r = cloud(50, 3), cloud(60, 4)
    region = Region(x_m=(-15.0, 15.0))
    scores = cloud_scores(p, r, names=ALL, region=region, direction="to_reference")
    single = {
        "rmse": root_mean_square_error,
        "mde": mean_distance_error,
        "mmde": max_mean_distance_error,
        "hd": hausdorff_distance,
        "hd95": hausdorff_distance_95,
        "chamfer": chamfer_distance,
    }
    for name, function in single.items():
        assert torch.equal(function(p, r, region=region, direction="to_reference"), scores[name]), name
    squared = chamfer_distance(p, r, region=region, direction="to_reference", squared=True)
    assert torch.equal(squared, scores["chamfer_squared"])


def test_directed_scores_look_one_way() -> None:
    clear = cloud(80, 5)
    more = torch.cat((clear, torch.tensor([[100.0, 0.0, 0.0]], dtype=clear.dtype)))
    there = values(cloud_scores(more, clear, names=FAR, direction="to_reference"))
    back = values(cloud_scores(more, clear, names=FAR, direction="to_distorted"))
    assert there["hd"] > 50.0
    assert set(back.values()) == {0.0}
    swapped = values(cloud_scores(clear, more, names=FAR, direction="to_distorted"))
    assert swapped == there
    forth = np.linalg.norm(more.numpy()[:, None] - clear.numpy()[None], axis=-1).min(1)
    assert there["mde"] == there["mmde"] == pytest.approx(forth.mean())
    assert there["rmse"] == pytest.approx(math.sqrt((forth**2).mean()))


@quick
@given(n=sizes, m=sizes, seed=seeds)
def test_chain_of_inequalities_and_symmetry(n: int, m: int, seed: int) -> None:
    p, r = cloud(n, seed), cloud(m, seed + 1)
    s = values(cloud_scores(p, r))
    slack = 1.0 + 1e-12  # rounding of the means
    assert 0.0 <= s["hd95"] <= s["hd"] * slack
    assert s["mde"] <= s["mmde"] * slack
    assert s["mmde"] <= s["hd"] * slack
    assert s["mde"] <= s["rmse"] * slack
    assert s["rmse"] <= s["hd"] * slack
    assert values(cloud_scores(r, p)) == pytest.approx(s, rel=1e-12)


@quick
@given(n=sizes, m=sizes, k=sizes, seed=seeds)
def test_hausdorff_is_a_metric(n: int, m: int, k: int, seed: int) -> None:
    a, b, c = cloud(n, seed), cloud(m, seed + 1), cloud(k, seed + 2)
    ab, bc, ac = (float(hausdorff_distance(*pair)) for pair in ((a, b), (b, c), (a, c)))
    assert float(hausdorff_distance(a, a.flip(0))) == 0.0 < ab
    assert ac <= (ab + bc) * (1.0 + 1e-12)


@quick
@given(n=sizes, seed=seeds)
def test_identical_clouds_score_zero_and_distances_scale(n: int, seed: int) -> None:
    p, r = cloud(n, seed), cloud(n, seed + 1)
    assert set(values(cloud_scores(p, p, names=ALL)).values()) == {0.0}
    one, four = cloud_scores(p, r, names=FAR), cloud_scores(4.0 * p, 4.0 * r, names=FAR)
    for name in FAR:
        assert float(four[name]) == 4.0 * float(one[name])  # a power of two is exact


def test_shifted_grid_is_the_shift_everywhere() -> None:
    grid = torch.cartesian_prod(*[torch.arange(1.0, 6.0)] * 3).double()
    shift = torch.tensor([0.0, 0.3, 0.0], dtype=torch.float64)  # less than half the spacing
    found = values(cloud_scores(grid + shift, grid, names=(*FAR, "chamfer")))
    assert found == pytest.approx({**dict.fromkeys(FAR, 0.3), "chamfer": 0.6}, rel=1e-12)


def test_two_points_against_one() -> None:
    p = torch.tensor([[1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    r = torch.tensor([[2.0, 0.0, 0.0]])
    # d_PR = 1, 3; d_RP = 1; the 95th percentile of 1 and 3 is 2.9.
    wanted = {"sdm": 1.0, "rmse": math.sqrt(11 / 3), "mde": 5 / 3, "mmde": 2.0, "hd": 3.0, "hd95": 2.9}
    assert values(cloud_scores(p, r)) == pytest.approx(wanted, rel=1e-6)


def test_index_pairs_rows_and_nearest_does_not() -> None:
    clear = cloud(30, 6)
    turned = clear.roll(1, 0)
    wanted = math.sqrt(float((turned - clear).square().sum(-1).mean()))
    assert float(root_mean_square_error(turned, clear, correspondence="index")) == pytest.approx(wanted, rel=1e-12)
    assert float(root_mean_square_error(turned, clear)) == 0.0


def test_index_leaves_out_rows_that_one_cloud_lost() -> None:
    clear = cloud(10, 7)
    moved = clear + 1.0
    moved[2] = 0.0  # no return
    moved[5] = math.nan
    found = root_mean_square_error(moved, clear, correspondence="index")
    assert float(found) == pytest.approx(math.sqrt(3.0), rel=1e-12)


def test_index_refuses_clouds_of_different_length() -> None:
    with pytest.raises(ValueError, match=r"needs clouds of one length; got 4 and 5 rows"):
        cloud_scores(cloud(4, 8), cloud(5, 8), correspondence="index")


def test_lost_points_padding_and_further_columns_do_not_count() -> None:
    p, r = cloud(40, 9), cloud(35, 10)
    wanted = values(cloud_scores(p, r, names=ALL))
    lost = torch.tensor([[0.0, 0.0, 0.0], [math.nan, 1.0, 1.0], [1.0, math.inf, 1.0], [1.0, 1.0, -math.inf]])
    with_lost = torch.cat((lost.double(), p))
    with_columns = torch.cat((with_lost, torch.full((44, 2), math.nan, dtype=p.dtype)), 1)
    assert values(cloud_scores(with_columns, r, names=ALL)) == wanted
    padded = torch.cat((r, torch.full((5, 3), 7.0, dtype=r.dtype)))
    valid = torch.arange(40) < 35
    assert values(cloud_scores(p, padded, names=ALL, reference_valid=valid)) == wanted
    assert values(cloud_scores(p, padded, names=ALL)) != wanted


def test_region_bounds_both_clouds_first() -> None:
    p, r = cloud(60, 11), cloud(50, 12)
    region = Region(x_m=(-5.0, 9.0), z_m=(-math.inf, 4.0))
    cut = [c[(c[:, 0] >= -5.0) & (c[:, 0] <= 9.0) & (c[:, 2] <= 4.0)] for c in (p, r)]
    assert 0 < len(cut[0]) < 60
    assert values(cloud_scores(p, r, region=region)) == values(cloud_scores(*cut))
    with pytest.raises(ValueError, match=r"x_m must be \(lowest, highest\) in m; got \(3.0, 1.0\)"):
        Region(x_m=(3.0, 1.0))


def test_batch_gives_what_its_elements_give() -> None:
    p, r = torch.stack([cloud(30, s) for s in range(6)]), torch.stack([cloud(20, s) for s in range(10, 16)])
    valid = torch.rand(6, 30, generator=torch.Generator().manual_seed(1)) < 0.7
    together = cloud_scores(p.reshape(2, 3, 30, 3), r.reshape(2, 3, 20, 3), distorted_valid=valid.reshape(2, 3, 30))
    listed = cloud_scores(list(p), list(r), distorted_valid=list(valid))
    dropped = cloud_scores([c[v] for c, v in zip(p, valid, strict=True)], list(r))
    for name in CLOUD_SCORES:
        alone = torch.stack([cloud_scores(p[i][valid[i]], r[i])[name] for i in range(6)])
        assert together[name].shape == (2, 3)
        for found in (together[name].flatten(), listed[name], dropped[name]):
            assert torch.equal(found, alone), name


@pytest.mark.parametrize("direction", ["both", "to_reference", "to_distorted"])
@pytest.mark.parametrize("correspondence", ["nearest", "index"])
def test_empty_clouds_have_defined_scores(direction: str, correspondence: str) -> None:
    nothing, proper = torch.zeros(9, 3), cloud(9, 13, torch.float32)
    options: dict[str, Any] = {"names": ALL, "direction": direction, "correspondence": correspondence}
    for pair in ((nothing, proper), (proper, nothing)):
        found = values(cloud_scores(*pair, **options))
        assert found.pop("sdm") == 1.0
        assert set(found.values()) == {math.inf}
    assert set(values(cloud_scores(nothing, nothing, **options)).values()) == {0.0}
    if correspondence == "nearest":
        assert float(cloud_scores(torch.zeros(0, 3), proper, **options)["mde"]) == math.inf


def test_no_clouds_are_no_scores_of_their_type() -> None:
    assert {(score.shape, score.dtype) for score in cloud_scores([], []).values()} == {((0,), torch.float32)}
    for dtype, wanted in ((torch.float64, torch.float64), (torch.float16, torch.float32), (torch.int64, torch.float32)):
        none = torch.zeros(2, 0, 5, 3, dtype=dtype), torch.zeros(2, 0, 4, 3, dtype=dtype)
        found = [*cloud_scores(*none, names=ALL).values(), shape_signature_distance(*none)]
        assert {(score.shape, score.dtype) for score in found} == {((2, 0), wanted)}
    mixed = torch.zeros(0, 5, 3), torch.zeros(0, 4, 3, dtype=torch.float64)
    assert cloud_scores(*mixed, names=("hd",))["hd"].dtype == torch.float64


@pytest.mark.parametrize("search", ["tree", "exhaustive"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("n", [30, 2000])  # all pairs of points, and drawn ones
def test_clouds_as_far_as_they_may_be_have_finite_scores(n: int, dtype: torch.dtype, search: str) -> None:
    corners = FARTHEST_M * torch.tensor([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]], dtype=dtype)
    p, r = torch.cat((cloud(n, 23, dtype), corners[:1])), torch.cat((cloud(n, 24, dtype), corners[1:]))
    found = values(cloud_scores(p, r, names=ALL, search=search))
    assert all(math.isfinite(score) for score in found.values()), found
    # To the near cloud: sqrt(3) FARTHEST_M, to single precision.
    assert found["hd"] == pytest.approx(math.sqrt(3.0) * FARTHEST_M, rel=1e-6)


@pytest.mark.parametrize(
    "far", [torch.tensor(2e18), torch.tensor(-3e38), torch.tensor(1e300, dtype=torch.float64), torch.tensor(2**62)]
)
def test_clouds_farther_away_are_refused_unless_left_out(far: Tensor) -> None:
    p = torch.cat((cloud(20, 25).to(far.dtype), far.expand(1, 3)))
    r = cloud(20, 26).to(far.dtype)
    for pair, which in (((p, r), "distorted"), ((r, p), "reference")):
        with pytest.raises(ValueError, match=rf"cloud_scores: coordinates of {which} must be within 1e\+18 m; got "):
            cloud_scores(*pair)
        with pytest.raises(ValueError, match=f"shape_signature_distance: coordinates of {which} must be within"):
            shape_signature_distance(*pair)
    wanted = values(cloud_scores(p[:-1], r))
    assert values(cloud_scores(p, r, region=Region(y_m=(-1e9, 1e9)))) == wanted
    assert values(cloud_scores(p, r, distorted_valid=torch.arange(21) < 20)) == wanted


def test_names_come_in_any_form_but_a_text() -> None:
    p, r = cloud(5, 27), cloud(6, 28)
    wanted = values(cloud_scores(p, r))
    for names in (iter(["hd", "mde"]), ["hd", "mde", "hd"], {"hd": 1, "mde": 2}):
        assert values(cloud_scores(p, r, names=names)) == {name: wanted[name] for name in ("hd", "mde")}
    with pytest.raises(TypeError, match=r"cloud_scores: names must be a list of names such as .*got the text 'hd'"):
        cloud_scores(p, r, names="hd")


@pytest.mark.parametrize(
    ("distorted", "reference", "options", "message"),
    [
        (
            torch.zeros(5, 2),
            torch.zeros(5, 3),
            {},
            r"distorted must be \(..., N, 3 or more\) = x, y, z in m; got \(5, 2",
        ),
        (torch.zeros(2, 5, 3), torch.zeros(3, 5, 3), {}, r"batches of one size; got \(2, 5, 3\) and \(3, 5, 3\)"),
        ([torch.zeros(5, 3)], torch.zeros(5, 3), {}, r"batches of one size; got a list of 1 and \(5, 3\)"),
        ([torch.zeros(1, 5, 3)], [torch.zeros(5, 3)], {}, r"clouds of a list must be \(N, 3 or more\)"),
        (
            torch.ones(5, 3),
            torch.ones(5, 3),
            {"distorted_valid": torch.ones(5)},
            r"distorted_valid must be bool \(5,\)",
        ),
        (torch.ones(5, 3), torch.ones(5, 3), {"names": ("hd59",)}, r"Did you mean 'hd95'"),
        (torch.ones(5, 3), torch.ones(5, 3), {"direction": "forth"}, r"direction must be one of both"),
        (torch.ones(5, 3), torch.ones(5, 3), {"search": "fast"}, r"search must be one of auto"),
    ],
)
def test_wrong_input_is_refused(distorted: Any, reference: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cloud_scores(distorted, reference, **options)


def test_numbers_that_are_no_clouds_are_refused() -> None:
    with pytest.raises(TypeError, match="reference must be a tensor or a sequence of Tensor; got 'cloud'"):
        cloud_scores(torch.ones(3, 3), "cloud")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"must hold real numbers; got torch\.bool"):
        cloud_scores(torch.ones(3, 3, dtype=torch.bool), torch.ones(3, 3))


def test_gradients_are_those_of_the_definition_and_finite() -> None:
    p, r = cloud(12, 14).requires_grad_(), cloud(10, 15).requires_grad_()
    for name in ALL:
        assert torch.autograd.gradcheck(lambda a, b, name=name: cloud_scores(a, b, names=(name,))[name], (p, r)), name
        same = cloud_scores(p, p.detach(), names=(name,))[name]
        (gradient,) = torch.autograd.grad(same, p)
        assert bool(torch.isfinite(gradient).all()), name


def test_float32_agrees_with_float64_far_from_the_origin() -> None:
    p, r = cloud(300, 16, torch.float32), cloud(300, 17, torch.float32)
    p[:, 0] += 4096.0
    r[:, 0] += 4096.0
    for search in ("tree", "exhaustive"):
        single = cloud_scores(p, r, search=search)
        double = cloud_scores(p.double(), r.double(), search=search)
        assert single["hd"].dtype == torch.float32
        # The inputs are the same numbers: what is left is the rounding of the scores and, in sdm, of its distances.
        assert values(single) == pytest.approx(values(double), rel=1e-6, abs=1e-6)


def test_searches_agree_in_portions_and_at_crowded_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearest, "PORTION", 7000)
    crowd = torch.ones(700, 3, dtype=torch.float64)
    p, r = torch.cat((cloud(300, 18), crowd)), torch.cat((crowd, cloud(400, 19)))
    for pair in ((p, r), (p, r[700:]), (p[:300], r)):
        tree, exhaustive = (nearest_distances(*pair, search=search) for search in ("tree", "exhaustive"))
        for one, other in zip(tree, exhaustive, strict=True):
            assert torch.allclose(one, other, rtol=1e-12, atol=0.0)


def test_a_crowd_at_one_place_is_not_searched_point_by_point() -> None:
    # Padding by copies of one point: unmerged, 4e10 distances, minutes.
    p = torch.cat((cloud(1000, 20), torch.ones(200_000, 3, dtype=torch.float64)))
    found = nearest_distances(p, p)
    assert float(found[0].max()) == float(found[1].max()) == 0.0


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_the_gpu_gives_the_scores_of_the_processor() -> None:
    p, r = cloud(3000, 21, torch.float32), cloud(2500, 22, torch.float32)
    there = cloud_scores(p.cuda(), r.cuda(), names=ALL)
    assert all(score.is_cuda for score in there.values())
    assert values(there) == pytest.approx(values(cloud_scores(p, r, names=ALL)), rel=1e-5)
