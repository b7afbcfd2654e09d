"""Deposits by classes of columns (``add_listed``) and by pairs (``add_pairs``) against every pixel of every mark."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchweather.camera.particles import streaks
from torchweather.camera.particles.depth_blocks import DepthBlocks
from torchweather.camera.particles.streaks import Marks, add_listed, add_pairs, chord_share, trapezoid_share

HEIGHT, WIDTH, NUMBER = 48, 40, 60


def marks_of(lean: float | None, widest_px: float) -> Marks:
    """Marks of many sizes, some of them beyond the edges or behind the scene."""
    random = torch.Generator().manual_seed(5)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(NUMBER, generator=random)

    down = uniform(0.1, 25.0)
    return Marks(
        sample=None,
        u_px=uniform(-3.0, WIDTH + 3.0),
        v_px=uniform(-6.0, HEIGHT + 6.0),
        motion_u_px=None if lean is None else lean * down,
        motion_v_px=down,
        width_px=uniform(0.05, widest_px),
        opacity=uniform(0.0, 1.0),
        depth_m=uniform(1.0, 30.0),
        clearness=uniform(0.0, 1.0),
    )


def covered(marks: Marks, k: int) -> Tensor:
    """Coverage ``(H, W)`` by one mark: each pixel's share along the path times its share across it."""
    frame = streaks._frame(marks.take(slice(k, k + 1)))
    steep = frame.steep is None or bool(frame.steep)
    rows, columns = (HEIGHT, WIDTH) if steep else (WIDTH, HEIGHT)
    down, aside = torch.arange(rows)[:, None], torch.arange(columns)
    offset = down - frame.major
    minor = frame.minor if frame.slope is None else frame.minor + frame.slope * offset
    left, right = aside - 0.5 - minor, aside + 0.5 - minor
    share = chord_share(right / frame.across) - chord_share(left / frame.across)
    reach = 0.5 * frame.across
    breadth = torch.minimum(right, reach) - torch.maximum(left, -reach)
    chord = frame.chord
    if float(frame.width) > 1.0:  # the disk's area in the column over its breadth
        mean = (math.pi / 4) * frame.width * share * frame.across / breadth.clamp_min(1e-3)
        chord = torch.minimum(mean.clamp_min(1e-2), frame.width)
    ends = (trapezoid_share(offset + side, frame.length, chord) for side in (-0.5, 0.5))
    above, below = ends
    coverage = (frame.area * share * (below - above)).clamp(0.0, 1.0 - 2.0**-20)
    return coverage if steep else coverage.T


def in_rows(marks: Marks) -> Marks:
    """Marks as a graph has them, each number ``(1, P)``."""
    present = {name: value for name, value in vars(marks).items() if value is not None}
    return replace(marks, **{name: value[None] for name, value in present.items()})


@pytest.mark.parametrize("by_columns", [False, True])
@pytest.mark.parametrize("widest_px", [0.9, 7.0])
@pytest.mark.parametrize("lean", [None, 0.0, 0.4, -2.5])
def test_marks_of_like_columns_and_pairs_add_up_to_every_pixel_of_every_mark(
    lean: float | None, widest_px: float, by_columns: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streaks, "PAIRS_AT_ONCE", 97)  # several portions of a class
    marks = marks_of(lean, widest_px)
    depth_m = torch.full((HEIGHT, WIDTH), 100.0)
    depth_m[:, : WIDTH // 2] = 12.0
    wanted, faded = (torch.zeros(HEIGHT * WIDTH) for _ in range(2))
    assert marks.clearness is not None
    for k in range(NUMBER):
        optical = -torch.log1p(-covered(marks, k)) * (marks.depth_m[k] < depth_m)
        wanted += optical.flatten()
        faded += (optical * marks.clearness[k]).flatten()

    def laid(image: Tensor) -> Tensor:
        return (image.T if by_columns else image).flatten()

    for blocks in (None, DepthBlocks.of(depth_m[None, None])):
        found, found_faded = torch.zeros(HEIGHT * WIDTH), torch.zeros(HEIGHT * WIDTH)
        size = (HEIGHT, WIDTH)
        add_listed(found, found_faded, marks, laid(depth_m), size, blocks, by_columns=by_columns)
        # The order of a sum, and of differences between the ends of a long path: some steps of float32.
        for ours, theirs in ((found, wanted), (found_faded, faded)):
            torch.testing.assert_close(ours, laid(theirs.view(HEIGHT, WIDTH)), rtol=1e-4, atol=2e-6)
    nothing = torch.zeros(1, HEIGHT * WIDTH)
    by_pairs = add_pairs(nothing, nothing, in_rows(marks), depth_m.view(1, -1), (HEIGHT, WIDTH))
    for pairs, theirs in zip(by_pairs, (wanted, faded), strict=True):
        assert pairs is not None
        torch.testing.assert_close(pairs[0], theirs, rtol=1e-4, atol=2e-6)
    assert float(wanted.max()) > 0.05


def test_a_path_of_a_graph_is_the_trapezoid_of_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    random = torch.Generator().manual_seed(2)
    length, chord = (0.01 + 30.0 * torch.rand(1, 4000, generator=random) ** 3 for _ in range(2))
    row = torch.floor(70.0 * torch.rand(1, 4000, generator=random))
    offset = -0.5 * (length + chord) + torch.rand(1, 4000, generator=random) - 0.5
    by_torch = streaks._along(row, offset, length, chord)
    monkeypatch.setattr(streaks, "is_exporting", lambda: True)
    # Differences of squares up to 100 px: some steps of float32 of 1e4, 1e-3 each.
    torch.testing.assert_close(streaks._along(row, offset, length, chord), by_torch, rtol=1e-5, atol=1e-2)
    assert float(by_torch.max()) > 10.0
    assert float((by_torch == 0).float().mean()) > 0.1  # rows behind the far end


def test_marks_of_several_samples_stay_apart() -> None:
    marks = marks_of(0.3, 3.0)
    depth_m = torch.full((2 * HEIGHT * WIDTH,), 100.0)
    sample = torch.arange(NUMBER) % 2
    nothing = torch.zeros_like(depth_m)
    both, _ = add_listed(nothing.clone(), None, replace(marks, sample=sample), depth_m, (HEIGHT, WIDTH))
    rows = in_rows(replace(marks, sample=sample))
    by_pairs, _ = add_pairs(nothing[None], None, rows, depth_m[None], (HEIGHT, WIDTH))
    torch.testing.assert_close(by_pairs[0], both, rtol=1e-4, atol=2e-6)
    for k in range(2):
        own = replace(marks, **{name: getattr(marks, name)[k::2] for name in FIELDS})
        alone = torch.zeros(HEIGHT * WIDTH)
        add_listed(alone, None, own, depth_m[: HEIGHT * WIDTH], (HEIGHT, WIDTH))
        assert torch.equal(both.view(2, -1)[k], alone)


FIELDS = ("u_px", "v_px", "motion_u_px", "motion_v_px", "width_px", "opacity", "depth_m", "clearness")
