"""Clouds of the embedded test track with road users at random places, and a small net that says what each point is."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from parts.car_detector import cars_on_the_track
from torch import Tensor, nn

import torchweather as tw
from torchweather.scenes import Scene, SceneLabel, lidar_view
from torchweather.scenes.actors import cyclist, pedestrian

COLUMNS = 256
SENSOR = tw.Lidar.preset("velodyne-hdl-32e", columns=COLUMNS)
ROWS = len(SENSOR.elevations_deg or ())
CLASSES = ("ground", "car", "person", "vegetation", "structure", "weather")
WEATHER = CLASSES.index("weather")  # drops, flakes and fog: no object is of it
OF_LABEL = {
    **dict.fromkeys((SceneLabel.ROAD, SceneLabel.LANE_MARKING, SceneLabel.KERB, SceneLabel.GRASS), 0),
    SceneLabel.CAR: 1,
    **dict.fromkeys((SceneLabel.PEDESTRIAN, SceneLabel.CYCLIST), 2),
    SceneLabel.TREE: 3,
}
NONE = -1  # beams without a return are of no class


@dataclass(frozen=True)
class Cloud:
    """A clear scan, ring by ring: points ``(N, 5)``, directions of the beams ``(N, 3)``, classes ``(N,)``."""

    points: Tensor
    directions: Tensor
    classes: Tensor


def road_users(draw: np.random.Generator) -> Scene:
    """The test track with cars, people and bicycles."""
    scene = cars_on_the_track(draw)
    people = []
    for k in range(int(draw.integers(3, 8))):
        place = (
            float(draw.uniform(4.0, 35.0)),
            float(draw.choice([-4.0, -3.0, 2.0, 5.0, 7.0]) + draw.normal(0.0, 0.5)),
        )
        make = pedestrian if draw.random() < 0.6 else cyclist
        people.append(make(f"person {k}", place, yaw_rad=float(draw.uniform(0.0, 2.0 * math.pi))))
    return Scene("road users", (*scene.objects, *people))


def cloud(seed: int) -> Cloud:
    view = lidar_view(road_users(np.random.default_rng(seed)), SENSOR, range_noise_seed=seed)
    classes = torch.tensor([OF_LABEL.get(SceneLabel(label), 4) for label in view.label.tolist()])
    return Cloud(view.points, view.directions, torch.where(view.hit, classes, NONE))


def picture_of(points: Tensor) -> Tensor:
    """Scans ``(B, N, 5)`` as pictures ``(B, 6, rows, columns)``: a return, range, place and intensity of each beam."""
    xyz, intensity = points[..., :3], points[..., 3]
    range_m = xyz.norm(dim=-1, keepdim=True)
    there = (range_m > 0).float()
    seen = torch.cat([there, (range_m + 1).log() * there / 4, xyz / 20, intensity[..., None] / 100], -1)
    return seen.reshape(len(points), ROWS, COLUMNS, 6).permute(0, 3, 1, 2)


class Segmenter(nn.Module):
    """Convolutions over the scan, which is closed in azimuth; columns are looked at in three widths."""

    def __init__(self) -> None:
        super().__init__()
        sizes = [(6, 24, 1), (24, 32, 1), (32, 32, 2), (32, 32, 4), (32, 32, 1)]
        self.layers = nn.ModuleList(
            nn.Conv2d(inside, outside, 3, dilation=(1, wide)) for inside, outside, wide in sizes
        )
        self.norms = nn.ModuleList(nn.GroupNorm(8, outside) for _, outside, _ in sizes)
        self.out = nn.Conv2d(32 + 24, len(CLASSES), 1)

    def forward(self, seen: Tensor) -> Tensor:
        """``(B, 6, rows, columns)`` to logits ``(B, classes, rows, columns)``."""
        early = None
        for layer, norm in zip(self.layers, self.norms, strict=True):
            wide = layer.dilation[1]
            closed = nn.functional.pad(seen, (wide, wide, 0, 0), mode="circular")
            seen = norm(layer(nn.functional.pad(closed, (0, 0, 1, 1)))).relu()
            early = seen if early is None else early
        return self.out(torch.cat([seen, early], 1))


def trained(batches: Iterable[tuple[Tensor, Tensor]], steps: int, seed: int, device: str = "cpu") -> Segmenter:
    """A net that has learned from so many batches of points ``(B, N, 5)`` and classes ``(B, N)``."""
    torch.manual_seed(seed)
    net = Segmenter().to(device)
    optimiser = torch.optim.AdamW(net.parameters(), lr=4e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 8e-3, total_steps=steps)
    weight = torch.tensor([1.0, 2.0, 6.0, 1.0, 2.0, 1.0], device=device)  # rare ones count more
    for points, classes in batches:
        wanted = classes.reshape(-1, ROWS, COLUMNS).to(device)
        loss = nn.functional.cross_entropy(net(picture_of(points.to(device))), wanted, weight, ignore_index=NONE)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return net.eval()
