"""Overlap of boxes against closed forms and against a polygon that is cut by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.metrics.box_overlap import bev_coverage, bev_iou, box_coverage, box_iou

# Sums of some dozens of products of numbers up to 100, each rounded to 1e-16 of its size.
ROUNDING = 1e-12


def turned(count: int, seed: int, spread_m: float = 6.0) -> Tensor:
    """Rectangles near each other, cars and pedestrians, any heading."""
    draw = np.random.default_rng(seed)
    columns = (
        draw.uniform(-spread_m, spread_m, (count, 2)),
        draw.uniform(0.3, 6.0, (count, 2)),
        draw.uniform(-10, 10, (count, 1)),
    )
    return torch.from_numpy(np.concatenate(columns, 1))


def corners(box: Tensor) -> list[tuple[float, float]]:
    x, y, length, width, yaw = box.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    offsets = [(length / 2, width / 2), (-length / 2, width / 2), (-length / 2, -width / 2), (length / 2, -width / 2)]
    return [(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in offsets]


def area(polygon: list[tuple[float, float]]) -> float:
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True)) / 2


def cut(polygon: list[tuple[float, float]], start: tuple[float, float], end: tuple[float, float]) -> list:  # type: ignore[type-arg]
    """What of a polygon lies to the left of a line (Sutherland and Hodgman 1974)."""

    def side(point: tuple[float, float]) -> float:
        return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])

    kept = []
    for one, other in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if side(one) >= 0:
            kept.append(one)
        if (side(one) >= 0) != (side(other) >= 0):
            share = side(one) / (side(one) - side(other))
            kept.append((one[0] + share * (other[0] - one[0]), one[1] + share * (other[1] - one[1])))
    return kept


def slow_bev_iou(first: Tensor, second: Tensor) -> float:
    polygon, clip = corners(first), corners(second)
    for start, end in zip(clip, clip[1:] + clip[:1], strict=True):
        polygon = cut(polygon, start, end) if polygon else []
    shared = area(polygon) if polygon else 0.0
    return shared / (area(corners(first)) + area(corners(second)) - shared)


def test_turned_rectangles_overlap_as_polygons_cut_by_hand() -> None:
    first, second = turned(40, 1), turned(50, 2)
    slow = torch.tensor([[slow_bev_iou(a, b) for b in second] for a in first], dtype=torch.float64)
    assert 0.2 < float((slow > 0).double().mean()) < 0.9  # both kinds of pairs
    torch.testing.assert_close(bev_iou(first, second), slow, rtol=0, atol=ROUNDING)


def test_turned_rectangles_overlap_as_points_thrown_on_them_say() -> None:
    first, second = turned(1, 5, 1.0), turned(1, 6, 1.0)
    points = np.random.default_rng(0).uniform(-8, 8, (400_000, 2))

    def inside(box: Tensor) -> np.ndarray:  # type: ignore[type-arg]
        x, y, length, width, yaw = box[0].tolist()
        along = (points[:, 0] - x) * math.cos(yaw) + (points[:, 1] - y) * math.sin(yaw)
        across = (points[:, 1] - y) * math.cos(yaw) - (points[:, 0] - x) * math.sin(yaw)
        found: np.ndarray = (np.abs(along) < length / 2) & (np.abs(across) < width / 2)  # type: ignore[type-arg]
        return found

    both, either = inside(first) & inside(second), inside(first) | inside(second)
    share = both.sum() / either.sum()
    assert share > 0.1
    # A share p of n points has a standard error of sqrt(p (1 - p) / n); four of them.
    assert float(bev_iou(first, second)) == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / either.sum()))


def test_rectangles_that_are_not_turned_overlap_as_boxes_of_an_image() -> None:
    first, second = turned(30, 3), turned(30, 4)
    first[:, 4], second[:, 4] = 0.0, math.pi

    def edges(boxes: Tensor) -> Tensor:
        return torch.cat([boxes[:, :2] - boxes[:, 2:4] / 2, boxes[:, :2] + boxes[:, 2:4] / 2], 1)

    torch.testing.assert_close(bev_iou(first, second), box_iou(edges(first), edges(second)), rtol=0, atol=ROUNDING)


def test_two_crossed_cars_share_the_square_of_their_width() -> None:
    car = torch.tensor([[30.0, -4.0, 4.5, 1.8, 0.3]], dtype=torch.float64)
    across = car + torch.tensor([0.0, 0.0, 0.0, 0.0, math.pi / 2])
    shared = 1.8**2
    assert float(bev_iou(car, across)) == pytest.approx(shared / (2 * 4.5 * 1.8 - shared), abs=ROUNDING)


def test_an_octagon_is_shared_by_squares_turned_by_half_a_quarter() -> None:
    square = torch.tensor([[0.0, 0.0, 2.0, 2.0, 0.0], [0.0, 0.0, 2.0, 2.0, math.pi / 4]], dtype=torch.float64)
    octagon = 8 * (math.sqrt(2) - 1)  # of inradius 1
    assert float(bev_iou(square[:1], square[1:])) == pytest.approx(octagon / (8 - octagon), abs=ROUNDING)


@pytest.mark.parametrize("overlap", [box_iou, bev_iou])
def test_overlap_is_one_with_itself_and_symmetric(overlap) -> None:  # type: ignore[no-untyped-def]
    boxes, others = turned(25, 7), turned(20, 8)
    if overlap is box_iou:
        boxes, others = (torch.cat([b[:, :2], b[:, :2] + b[:, 2:4]], 1) for b in (boxes, others))
    torch.testing.assert_close(overlap(boxes, boxes).diagonal(), torch.ones(25).double(), rtol=0, atol=ROUNDING)
    torch.testing.assert_close(overlap(boxes, others), overlap(others, boxes).T, rtol=0, atol=ROUNDING)


def test_turned_overlap_ignores_rigid_motion_and_half_turns() -> None:
    first, second = turned(20, 9), turned(20, 10)
    before = bev_iou(first, second)
    angle, shift = 0.7, torch.tensor([120.0, -35.0], dtype=torch.float64)
    rotation = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]).double()

    def moved(boxes: Tensor) -> Tensor:
        return torch.cat([boxes[:, :2] @ rotation.T + shift, boxes[:, 2:4], boxes[:, 4:] + angle], 1)

    # The cosine above is rounded to float32's 6e-8: places shift by that times 10 m.
    torch.testing.assert_close(bev_iou(moved(first), moved(second)), before, rtol=0, atol=1e-6)
    half = second + torch.tensor([0, 0, 0, 0, math.pi]).double()
    torch.testing.assert_close(bev_iou(first, half), before, rtol=0, atol=1e-6)


def test_touching_nested_and_flat_rectangles() -> None:
    one = torch.tensor([[0.0, 0.0, 2.0, 2.0, 0.0]], dtype=torch.float64)
    others = torch.tensor(
        [
            [2.0, 0.0, 2.0, 2.0, 0.0],  # along an edge
            [2.0, 2.0, 2.0, 2.0, 0.0],  # at a corner
            [0.0, 0.0, 1.0, 1.0, 0.4],  # inside
            [0.0, 0.0, 8.0, 8.0, 1.0],  # around
            [0.0, 0.0, 2.0, 0.0, 0.3],  # without area
            [1.0, 0.0, 2.0, 2.0, 0.0],  # half
        ],
        dtype=torch.float64,
    )
    wanted = torch.tensor([[0.0, 0.0, 0.25, 4 / 64, 0.0, 1 / 3]], dtype=torch.float64)
    torch.testing.assert_close(bev_iou(one, others), wanted, rtol=0, atol=ROUNDING)
    assert bev_iou(others[4:5], others[4:5]).item() == 0.0
    point = torch.zeros(1, 4)
    assert box_iou(point, point).item() == 0.0


def test_coverage_is_the_share_of_the_first_box_whatever_the_size_of_the_second() -> None:
    small = torch.tensor([[4.0, 4.0, 6.0, 6.0], [8.0, 0.0, 12.0, 2.0], [20.0, 20.0, 21.0, 21.0], [5.0, 5.0, 5.0, 5.0]])
    region = torch.tensor([[0.0, 0.0, 10.0, 10.0]])
    assert box_coverage(small, region).tolist() == [[1.0], [0.5], [0.0], [0.0]]
    assert box_coverage(region, small)[0, 0] == pytest.approx(0.04)


def test_coverage_follows_from_intersection_over_union() -> None:
    """Both have the shared area: ``iou (a + b) / (1 + iou) = coverage a``; on the ground for turned rectangles."""
    first, second = turned(23, 11), turned(17, 12)
    area, other = (boxes[:, 2] * boxes[:, 3] for boxes in (first, second))
    iou = bev_iou(first, second)
    shared = iou * (area[:, None] + other) / (1 + iou)
    torch.testing.assert_close(bev_coverage(first, second), shared / area[:, None], rtol=0, atol=1e-9)
    assert float(bev_coverage(first, second).max()) > 0.5


@pytest.mark.parametrize(("overlap", "columns"), [(box_iou, 4), (bev_iou, 5), (box_coverage, 4), (bev_coverage, 5)])
def test_no_boxes_overlap_with_nothing(overlap, columns: int) -> None:  # type: ignore[no-untyped-def]
    none, some = torch.zeros(0, columns), torch.ones(3, columns)
    assert overlap(none, some).shape == (0, 3)
    assert overlap(some, none).shape == (3, 0)
    assert overlap(none, none).shape == (0, 0)


def test_many_rectangles_are_worked_on_in_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = turned(23, 11), turned(17, 12)
    whole = bev_iou(first, second)
    monkeypatch.setattr("torchweather.metrics.box_overlap.PORTION", 40)
    assert torch.equal(bev_iou(first, second), whole)


@pytest.mark.parametrize(
    ("overlap", "boxes", "said"),
    [
        (box_iou, torch.zeros(2, 5), r"\(N, 4\): left, top, right, bottom; got \(2, 5\)"),
        (bev_iou, torch.zeros(2, 4), r"\(N, 5\): x, y, length, width, yaw; got \(2, 4\)"),
        (bev_iou, torch.zeros(2, 5, dtype=torch.int64), "floating-point"),
        (bev_iou, [[0.0] * 5], r"must be a tensor; got \[\["),
        (box_iou, torch.tensor([[0.0, 0.0, -1.0, 1.0]]), "inside out"),
        (bev_iou, torch.tensor([[0.0, 0.0, 1.0, -1.0, 0.0]]), "negative"),
        (bev_iou, torch.full((1, 5), math.nan), "must be a finite number"),
    ],
)
def test_what_are_no_boxes_is_refused(overlap, boxes, said: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises((TypeError, ValueError), match=said):
        overlap(boxes, boxes)
