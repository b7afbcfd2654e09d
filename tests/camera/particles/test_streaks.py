"""Marks of single particles: conserved area, place, direction, depth test, compositing (PHYSICS.md 4.5)."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from tests.reference.every_particle import Particles, mark_patches
from torchweather.camera.particles.depth_blocks import DepthBlocks
from torchweather.camera.particles.streaks import Marks, add_listed

ORACLES = Path(__file__).parents[2] / "oracles" / "physics_oracles.json"


def marks_at(
    u: list[float],
    v: list[float],
    motion: tuple[float, float],
    width: float,
    *,
    opacity: float = 1.0,
    depth_m: float = 1.0,
) -> Marks:
    """Equal marks at several places; motion is (to the right, down), pixels."""
    n = len(u)
    return Marks(
        sample=None,
        u_px=torch.tensor(u),
        v_px=torch.tensor(v),
        motion_u_px=torch.full((n,), motion[0]),
        motion_v_px=torch.full((n,), motion[1]),
        width_px=torch.full((n,), width),
        opacity=torch.full((n,), opacity),
        depth_m=torch.full((n,), depth_m),
    )


def mask_of(marks: Marks, height: int, width: int, depth_m: Tensor | None = None, *, blocks: bool = False) -> Tensor:
    """Coverage ``(H, W)`` of the marks in front of a scene."""
    depth = torch.full((height, width), 100.0) if depth_m is None else depth_m
    extremes = DepthBlocks.of(depth[None, None]) if blocks else None
    total, _ = add_listed(torch.zeros(height * width), None, marks, depth.reshape(-1), (height, width), extremes)
    return -torch.expm1(-total.double()).view(height, width)


def padded(width_px: float, length_px: float, slant_rad: float) -> tuple[Marks, int, int]:
    """One mark on a frame that holds all of it; its centre lies at an odd fraction of a pixel."""
    motion = (length_px * math.sin(slant_rad), length_px * math.cos(slant_rad))
    height, width = (int(abs(way) + width_px) + 9 for way in (motion[1], motion[0]))
    return marks_at([width / 2 + 0.13], [height / 2 + 0.37], motion, width_px), height, width


@pytest.mark.parametrize("row", ["D1 mm Z2 m", "D1 mm Z5 m", "D1 mm Z20 m", "D3 mm Z2 m", "D3 mm Z10 m"])
def test_sum_of_one_drops_mask_is_the_area_of_its_disk(row: str) -> None:
    oracle = json.loads(ORACLES.read_text())["camera_streak"]["rows"][row]
    mark, height, width = padded(oracle["d_px"], oracle["motion_px"], 0.0)
    # The oracle is exact to 1e-9; the mask is float32 and goes through ln(1 - m) and back.
    assert float(mask_of(mark, height, width).sum()) == pytest.approx(oracle["sum_of_mask_exact"], rel=3e-5)


@pytest.mark.parametrize("slant_rad", [0.0, math.pi / 2, math.pi], ids=["down", "right", "up"])
@pytest.mark.parametrize("length_px", [0.0, 0.01, 0.3, 1.0, 3.0, 30.0, 300.0])
@pytest.mark.parametrize("width_px", [0.05, 0.3, 0.99, 1.01, 3.0, 12.0, 40.0])
def test_area_is_conserved_at_any_width_and_speed(width_px: float, length_px: float, slant_rad: float) -> None:
    mark, height, width = padded(width_px, length_px, slant_rad)
    # A wide disk at rest loses 6e-4 of its area where the coverage is held at 1; float32 does the rest.
    assert float(mask_of(mark, height, width).sum()) == pytest.approx(math.pi / 4 * width_px**2, rel=1e-3)


@pytest.mark.parametrize("slant_rad", [0.02, 0.3, math.pi / 4, 1.0, -0.6, 2.5])
@pytest.mark.parametrize("width_px", [0.05, 0.3, 0.99, 1.01, 3.0, 12.0])
@pytest.mark.parametrize("lengths", [1.0, 3.0, 20.0])
def test_area_is_conserved_along_any_direction(width_px: float, lengths: float, slant_rad: float) -> None:
    mark, height, width = padded(width_px, lengths * width_px, slant_rad)
    # Slanted marks shift their columns row by row; the chord is held within the path, which costs up to 1 %.
    assert float(mask_of(mark, height, width).sum()) == pytest.approx(math.pi / 4 * width_px**2, rel=1e-2)


def test_opacity_scales_the_area() -> None:
    """A defocused disk covers more pixels less: opacity times its area is the area of the sharp disk."""
    sharp = 2.0
    for blurred in (2.0, 5.0, 15.0):
        mark, height, width = padded(blurred, 20.0, 0.0)
        thin = marks_at(mark.u_px.tolist(), mark.v_px.tolist(), (0.0, 20.0), blurred, opacity=(sharp / blurred) ** 2)
        assert float(mask_of(thin, height, width).sum()) == pytest.approx(math.pi / 4 * sharp**2, rel=1e-4)


@pytest.mark.parametrize("slant_rad", [0.0, 0.3, math.pi / 4, -0.6, math.pi / 2])
@pytest.mark.parametrize("width_px", [0.2, 2.0])
def test_a_mark_lies_where_its_particle_is_and_along_its_path(width_px: float, slant_rad: float) -> None:
    length_px = 40.0
    mark, height, width = padded(width_px, length_px, slant_rad)
    mask = mask_of(mark, height, width)
    share = mask / mask.sum()
    rows, columns = torch.arange(height)[:, None].double(), torch.arange(width).double()
    v, u = float((share * rows).sum()), float((share * columns).sum())
    # A narrow mark along an axis lies in one column: its pixel is all that one can know.
    within_px = 0.5 if width_px < 1 and abs(math.sin(2 * slant_rad)) < 1e-6 else 0.02
    assert (u, v) == pytest.approx((float(mark.u_px), float(mark.v_px)), abs=within_px)
    along_v, along_u = (share * (rows - v) ** 2).sum(), (share * (columns - u) ** 2).sum()
    both = (share * (rows - v) * (columns - u)).sum()
    angle = 0.5 * math.atan2(2 * float(both), float(along_v - along_u))  # of the major axis, from straight down
    assert math.sin(angle - slant_rad) == pytest.approx(0.0, abs=0.01)
    # Path, disk and pixel add their variances: L^2/12 + b^2/16 + 1/12; half a pixel of L is one of the path's ends.
    major = float(along_v) * math.cos(slant_rad) ** 2 + float(along_u) * math.sin(slant_rad) ** 2
    major += 2 * float(both) * math.sin(slant_rad) * math.cos(slant_rad)
    assert major == pytest.approx(length_px**2 / 12 + width_px**2 / 16 + 1 / 12, rel=0.02)


@pytest.mark.parametrize(
    ("width_px", "length_px"), [(0.06, 1.0), (0.3, 4.0), (0.9, 3.0), (1.5, 10.0), (3.0, 6.0), (8.0, 30.0)]
)
def test_falling_marks_agree_with_the_reference_pixel_by_pixel(width_px: float, length_px: float) -> None:
    mark, height, width = padded(width_px, length_px, 0.0)
    mask = mask_of(mark, height, width).numpy()
    particle = Particles(*(np.array([float(value)]) for value in (mark.u_px, mark.v_px, 1.0, width_px, length_px)))
    wanted: NDArray[np.float64] = np.zeros((height, width))
    for values, row, column, _ in mark_patches(particle):
        wanted[row[0] : row[0] + values.shape[1], column[0] : column[0] + values.shape[2]] += values[0]
    # One chord for a column instead of the integral over its chords: 1 % of the mark's area sits one pixel off.
    assert np.abs(mask - wanted).sum() / wanted.sum() < 0.015


def test_falling_marks_need_no_horizontal_motion() -> None:
    mark, height, width = padded(1.7, 11.0, 0.0)
    falling = Marks(None, mark.u_px, mark.v_px, None, mark.motion_v_px, mark.width_px, mark.opacity, mark.depth_m)
    assert torch.allclose(mask_of(falling, height, width), mask_of(mark, height, width), atol=1e-6)


def test_overlapping_marks_multiply_what_they_let_through() -> None:
    one = mask_of(marks_at([10.0], [20.0], (0.0, 12.0), 3.0), 40, 20)
    other = mask_of(marks_at([10.5], [22.0], (0.0, 12.0), 3.0), 40, 20)
    both = mask_of(marks_at([10.0, 10.5], [20.0, 22.0], (0.0, 12.0), 3.0), 40, 20)
    assert torch.allclose(both, 1 - (1 - one) * (1 - other), atol=1e-6)
    assert float(both.sum()) < float((one + other).sum())


@pytest.mark.parametrize("blocks", [False, True])
def test_the_scene_hides_what_is_behind_it_pixel_by_pixel(blocks: bool) -> None:
    height, width = 64, 48
    generator = torch.Generator().manual_seed(0)
    u, v = (torch.rand(200, generator=generator) * (size + 20) - 10 for size in (width, height))
    marks = marks_at(u.tolist(), v.tolist(), (0.0, 9.0), 1.4, depth_m=5.0)
    free = mask_of(marks, height, width)
    depth = torch.full((height, width), 9.0)
    depth[20:41, 7:23] = 3.0
    hidden = mask_of(marks, height, width, depth, blocks=blocks)
    assert bool((free[20:41, 7:23] > 0).any())
    assert bool((hidden[20:41, 7:23] == 0).all())
    outside = depth > 5.0
    assert torch.allclose(hidden[outside], free[outside], atol=1e-7)


def test_a_particle_without_opacity_leaves_no_mark() -> None:
    assert float(mask_of(marks_at([5.0], [5.0], (0.0, 4.0), 2.0, opacity=0.0), 12, 12).sum()) == 0.0
