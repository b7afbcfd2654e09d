"""Frames of the embedded test track with cars at random places, and a small detector that finds them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

import torchweather as tw
from torchweather.image import develop
from torchweather.metrics import average_precision, box_iou
from torchweather.scenes import Scene, SceneLabel, test_track
from torchweather.scenes.actors import car

SIZE = (256, 192)  # all fourteen scores take 161 pixels a side
STRIDE = 4  # pixels to a cell of the detector's grid
LEAST_PX = 6  # smaller cars are neither learned nor missed
Batch = tuple[Tensor, Tensor, Tensor, Tensor]


# ---- frames --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Frame:
    """A clear frame: mosaic, depth, camera, boxes ``(N, 4)`` of the cars and which of them are too small to count."""

    bayer: Tensor
    depth_m: Tensor
    camera: tw.Camera
    boxes: Tensor
    small: Tensor


def cars_on_the_track(draw: np.random.Generator) -> Scene:
    """The test track with other cars: in both lanes and on the grass beside them."""
    gone = (SceneLabel.CAR, SceneLabel.CYCLIST, SceneLabel.PEDESTRIAN)
    kept = [thing for thing in test_track().objects if thing.label not in gone and not thing.name.startswith("board")]
    cars = []
    for lane, y_m in enumerate((0.0, 3.6, -6.0, -10.0)):
        x_m = draw.uniform(7.0, 16.0)
        while x_m < 45.0:
            if draw.random() < 0.6:
                yaw = draw.choice([0.0, math.pi]) + draw.normal(0.0, 0.05 if lane < 2 else 0.6)
                middle = np.array([x_m, y_m + draw.normal(0.0, 0.2)])
                rear = middle - 2.15 * np.array([math.cos(yaw), math.sin(yaw)])  # half a car's length
                paint = draw.choice(["paint_red", "paint_blue", "paint_silver"])
                cars.append(car(f"car {len(cars)}", tuple(rear.tolist()), float(yaw), str(paint)))
            x_m += draw.uniform(7.0, 16.0)
    return Scene("cars on the track", (*kept, *cars))


def frame(seed: int) -> Frame:
    draw = np.random.default_rng(seed)
    camera = replace(
        tw.Camera.preset("lucid-triton").resized(*SIZE),
        pitch_rad=float(draw.normal(0.0, 0.01)),
        height_m=float(draw.uniform(1.3, 1.8)),
    )
    view = cars_on_the_track(draw).view(camera, shot_noise_seed=seed)
    boxes, small = [], []
    for number in view.object_id[view.label == SceneLabel.CAR].unique():
        rows, columns = (view.object_id[0] == number).nonzero().T
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        boxes.append([float(edge) for edge in box])
        small.append(len(rows) < LEAST_PX**2 or box[3] - box[1] < LEAST_PX)
    return Frame(view.bayer, view.depth_m, camera, torch.tensor(boxes).reshape(-1, 4), torch.tensor(small).bool())


def picture(bayer: Tensor, camera: tw.Camera) -> Tensor:
    return develop(bayer, camera.bayer_pattern, exposure=1.3)


# ---- the detector: each cell says whether a car is there, and how far its four edges are ---------------------------


class Detector(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = [(3, 16, 2, 1), (16, 32, 2, 1), (32, 32, 1, 1), (32, 32, 1, 2), (32, 32, 1, 4), (32, 32, 1, 2)]
        for inside, outside, stride, dilation in channels:
            layers += [nn.Conv2d(inside, outside, 3, stride, dilation, dilation), nn.GroupNorm(8, outside), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Conv2d(32, 5, 1))

    def forward(self, pictures: Tensor) -> Tensor:
        """``(B, 3, H, W)`` to ``(B, 5, H / 4, W / 4)``: logit of a car, logarithms of the four distances in cells."""
        return self.layers(pictures - 0.5)

    @torch.no_grad()
    def detect(self, pictures: Tensor) -> list[dict[str, Any]]:
        """Boxes and scores of each picture, overlapping ones removed."""
        found = []
        for each in self(pictures):
            score, place = each[0].sigmoid().flatten().topk(200)
            x, y = centres(each.shape[1:]).flatten(1)[:, place]
            left, top, right, bottom = STRIDE * each[1:].flatten(1)[:, place].clamp(-4, 4).exp()
            boxes = torch.stack([x - left, y - top, x + right, y + bottom], 1)
            overlap, kept = box_iou(boxes, boxes) > 0.4, score > 0.02
            for k in range(len(boxes)):  # the surest first
                kept[k + 1 :] &= ~(kept[k] & overlap[k, k + 1 :])
            found.append({"boxes": boxes[kept], "scores": score[kept], "labels": ["car"] * int(kept.sum())})
        return found


def centres(grid: torch.Size) -> Tensor:
    """Pixel positions x and y of the cells' centres, ``(2, H, W)``."""
    rows, columns = (STRIDE * (torch.arange(number) + 0.5) for number in grid)
    return torch.stack([columns.expand(grid), rows[:, None].expand(grid)])


def targets(each: Frame) -> tuple[Tensor, Tensor, Tensor]:
    """Cells of a car, cells that count, and logarithms of the distances: ``(H, W)``, ``(H, W)``, ``(4, H, W)``."""
    x, y = centres(torch.Size((SIZE[1] // STRIDE, SIZE[0] // STRIDE)))
    positive, counts, edges = torch.zeros_like(x), torch.ones_like(x), torch.zeros(4, *x.shape)
    order = (each.boxes[:, 3]).argsort()  # nearer cars, further down, are drawn last
    for k in order.tolist():
        left, top, right, bottom = each.boxes[k]
        inside = (x > left) & (x < right) & (y > top) & (y < bottom)
        middle = ((x - (left + right) / 2).abs() < 0.3 * (right - left).clamp_min(STRIDE)) & (
            (y - (top + bottom) / 2).abs() < 0.3 * (bottom - top).clamp_min(STRIDE)
        )
        counts[inside & ~middle] = 0.0  # the rim of a car is neither
        if each.small[k]:
            counts[inside | middle] = 0.0
            continue
        positive[middle], counts[middle] = 1.0, 1.0
        distances = torch.stack([x - left, y - top, right - x, bottom - y]).clamp_min(0.5) / STRIDE
        edges[:, middle] = distances[:, middle].log()
    return positive, counts, edges


def trained(batches: Iterable[Batch], steps: int, seed: int = 0) -> Detector:
    """A detector that has learned from so many batches: pictures, and what ``targets`` says of them."""
    torch.manual_seed(seed)
    detector = Detector()
    optimiser = torch.optim.AdamW(detector.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 6e-3, total_steps=steps)
    for seen, positive, counts, edges in batches:
        if torch.rand(()) < 0.5:  # mirrored: left and right change places
            seen, positive, counts = (t.flip(-1) for t in (seen, positive, counts))
            edges = edges.flip(-1)[:, [2, 1, 0, 3]]
        seen = seen * (0.8 + 0.4 * torch.rand(len(seen), 1, 1, 1)) + 0.02 * torch.randn(seen.shape)
        out = detector(seen)
        surprise = nn.functional.binary_cross_entropy_with_logits(out[:, 0], positive, reduction="none")
        focal = surprise * (positive - out[:, 0].sigmoid()).abs() ** 2  # Lin et al. 2017: the easy cells weigh little
        number = positive.sum().clamp_min(1)
        apart = nn.functional.smooth_l1_loss(out[:, 1:], edges, beta=0.1, reduction="none").sum(1)
        loss = (4 * focal * counts).sum() / number + (apart * positive).sum() / number
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return detector.eval()


def precision(detector: Detector, pictures: Tensor, frames: list[Frame]) -> float:
    """Average precision at an overlap of a half, over all frames."""
    truths = [{"boxes": each.boxes, "labels": ["car"] * len(each.boxes), "ignore": each.small} for each in frames]
    [score] = average_precision(detector.detect(pictures), truths, thresholds=[0.5])
    return score.value
