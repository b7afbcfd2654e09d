"""Airlight of RGB photographs: the grey that a sky of each colour and light gives fog (PHYSICS.md 10.7)."""

from __future__ import annotations

import pytest
import torch

from torchweather import AsBayer, BayerFog, Fog
from torchweather.camera.depth import SceneDepth
from torchweather.sensors import Camera

HEIGHT, WIDTH = 40, 60
CAMERA = Camera.from_intrinsics(fx=50.0, fy=50.0, cx=29.5, cy=19.5, width=WIDTH, height=HEIGHT)


def airlight_under(red: float, green: float, blue: float) -> list[float]:
    """Airlight of a picture whose sky has these linear signals."""
    linear = torch.full((3, HEIGHT, WIDTH), 0.05)
    linear[:, : HEIGHT // 2] = torch.tensor([red, green, blue])[:, None, None]
    image = torch.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)
    sky = torch.zeros(1, HEIGHT, WIDTH)
    sky[:, : HEIGHT // 2] = 1.0
    depth_m = torch.where(sky > 0, torch.inf, 20.0)
    fog = AsBayer(BayerFog(Fog(mor_m=200.0), CAMERA))
    values: list[float] = fog.run(image, SceneDepth(depth_m, "exact", sky=sky)).airlight.flatten().tolist()
    return values


@pytest.mark.parametrize(
    ("sky", "grey"),
    [
        ((0.25, 0.25, 0.25), 0.25),  # overcast or misty: its own light
        ((0.60, 0.60, 0.60), 0.60),
        ((0.98, 0.98, 0.98), 0.70),  # overexposed: it says nothing
        ((0.25, 0.40, 0.55), 0.50),  # blue: darker than a fog that it and the sun light
        ((0.27, 0.27, 0.30), 0.27234),  # a touch of blue: lower bound 0.5 * 0.1 / 0.3, so its own luminance
        ((0.085, 0.10, 0.10), 0.25),  # dim with some blue: the bound 0.5 * 0.15 / 0.3 itself
        ((0.03, 0.03, 0.04), 0.030722),  # night: its own light
    ],
)
@pytest.mark.filterwarnings("ignore::torchweather.core.errors.TorchweatherWarning")
def test_grey_of_a_sky(sky: tuple[float, float, float], grey: float) -> None:
    assert airlight_under(*sky) == pytest.approx([grey] * 3, rel=2e-3)
