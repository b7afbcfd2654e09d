"""Suites of published benchmarks: their severities against the published numbers, and effects as conditions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import torchweather as tw
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness.frames import LabelledFrame, frame_in_weather
from torchweather.evaluation.sweep import CameraSubject, LidarSubject
from torchweather.recipes import Condition, read_recipe

ROOT = Path(__file__).parents[2]
LN_20 = math.log(20.0)  # the MOR's contrast of 5 %
# Published numbers. Robo3D: comments of the scripts in create/semantickitti_c. 3D_Corruptions_AD: LiDAR_corruptions.py.
# ImageNet-C: corruptions.py, fog c[0] and brightness c.
ROBO3D_SNOW, ROBO3D_WATER_MM, ROBO3D_CROSSTALK = [0.5, 1.0, 2.5], [0.2, 1.0, 1.2], [0.006, 0.008, 0.01]
ROBO3D_ALPHA, ROBO3D_JITTER_M, ROBO3D_BEAMS_OF_64 = [0.01, 0.03, 0.06], [0.2, 0.25, 0.3], [16, 32, 48]
AD_RATES, AD_ALPHA = [0.2, 0.73, 1.5625, 3.125, 7.29], [0.005, 0.01, 0.02, 0.03, 0.06]
AD_SUNLIGHT = [0.01, 0.02, 0.03, 0.04, 0.05]
IMAGENET_FOG, IMAGENET_BRIGHTNESS = [1.5, 2.0, 2.5, 2.5, 3.0], [0.1, 0.2, 0.3, 0.4, 0.5]


def values(suite: str, name: str) -> list[float]:
    return [one.value for one in read_recipe(suite, "suite").conditions() if one.name == name]


def test_robo3d_has_the_published_severities() -> None:
    assert values("lidar/robo3d", "snow") == ROBO3D_SNOW
    assert values("lidar/robo3d", "wet-road") == ROBO3D_WATER_MM
    assert values("lidar/robo3d", "crosstalk") == ROBO3D_CROSSTALK
    assert values("lidar/robo3d", "fog") == pytest.approx([LN_20 / one for one in ROBO3D_ALPHA], rel=1e-3)
    assert values("lidar/robo3d", "motion blur") == pytest.approx([0.1 * one for one in ROBO3D_JITTER_M])
    shares = [one / (2 * math.pi) for one in values("lidar/robo3d", "beam missing")]
    assert shares == pytest.approx([one / 64 for one in ROBO3D_BEAMS_OF_64], abs=1e-4)
    assert read_recipe("lidar/robo3d", "suite").severities == 3


def test_3d_corruptions_ad_has_the_published_severities() -> None:
    assert values("lidar/3d-corruptions-ad", "rain") == values("lidar/3d-corruptions-ad", "snow") == AD_RATES
    assert values("lidar/3d-corruptions-ad", "fog") == pytest.approx([LN_20 / one for one in AD_ALPHA], rel=1e-3)
    assert values("lidar/3d-corruptions-ad", "sunlight") == AD_SUNLIGHT


def test_imagenet_c_leaves_the_published_contrast_and_brightness() -> None:
    at_30_m = [math.exp(-LN_20 * 30.0 / one) for one in values("camera/imagenet-c-weather", "fog")]
    # The fourth of the published five has the third's blend; a suite must get heavier.
    assert at_30_m == pytest.approx([1 / (1 + c) for c in IMAGENET_FOG], abs=0.014)

    def light(value: float) -> float:  # sRGB
        return ((value + 0.055) / 1.055) ** 2.4

    factors = [light(0.5 + c) / light(0.5) for c in IMAGENET_BRIGHTNESS]
    assert values("camera/imagenet-c-weather", "brightness") == pytest.approx(factors, abs=0.006)


def test_conditions_are_named_with_their_units() -> None:
    found = read_recipe("lidar/robo3d", "suite").conditions()
    assert [one.text for one in found if one.severity == 3] == [
        "Fog 49.93 m",
        "Wet-road 1.2 mm",
        "Snow 2.5 mm/h",
        "Motion blur 0.03 m",
        "Beam missing 4.7124 rad",
        "Crosstalk 0.01",
        "Incomplete echo 9 dB",
    ]


def condition(suite: str, name: str) -> Condition:
    return next(one for one in read_recipe(suite, "suite").conditions() if (one.name, one.severity) == (name, 3))


class Ignored:
    """Truth that follows the points."""

    def __init__(self, classes: Any) -> None:
        self.classes = classes


class Keeper:
    """A detector that keeps the points it is given."""

    def of_cloud(self, points: torch.Tensor) -> None:
        self.points = points


def test_a_detector_gets_a_cloud_with_the_effect_of_the_condition() -> None:
    azimuth = torch.arange(360.0) * math.pi / 180
    points = torch.stack([10 * azimuth.cos(), 10 * azimuth.sin(), 0 * azimuth, 100 + 0 * azimuth], 1)
    subject = LidarSubject("wall", points=points, lidar=tw.Lidar.preset("velodyne-hdl-64e"))
    keeper: Any = Keeper()
    asked = frame_in_weather(LabelledFrame("wall", subject, Ignored(azimuth)), keeper, None)
    asked.weather(condition("lidar/robo3d", "beam missing"), 1, (), first=False)
    assert len(keeper.points) == pytest.approx(90, abs=2)  # three quarters of 360 lie in the lost sector


def test_a_frame_in_a_condition_has_its_effect() -> None:
    camera = tw.Camera.from_intrinsics(fx=30.0, fy=30.0, cx=15.5, cy=7.5, width=32, height=16)
    grey, depth_m = torch.full((1, 16, 32), 0.1), torch.full((1, 16, 32), 20.0)
    brighter = condition("camera/imagenet-c-weather", "brightness")
    found = CameraSubject("grey", data=grey, camera=camera, depth_m=depth_m).render(
        brighter.weather, 1, brighter.effects
    )
    assert float(found.mean()) == pytest.approx(0.282, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"effects": {"x": {"effect": "lidar.crosstalk", "probability": [0.1, 0.2]}}},
            "effects.x: expected one parameter",
        ),
        (
            {"effects": {"x": {"effect": "lidar.crosstalk", "probability": [0.1, 0.2, 3]}}},
            "effects.x: .*lie in 0..1; got 3",
        ),
        (
            {"effects": {"x": {"effect": "lidar.nothing", "probability": [0.1, 0.2, 0.3]}}},
            "effects.x: .*must be one of",
        ),
        ({"effects": {"x": {"effect": "camera.defocus", "radius_px": [1, 2, 3]}}}, "expected an effect of a lidar"),
        ({"effects": {"fog": {"effect": "lidar.crosstalk", "probability": [0.1, 0.2, 0.3]}}}, "a name that no weather"),
        ({"effects": None, "weathers": None}, "weathers or effects is missing"),
        ({"severities": 1}, "severities"),
        ({"severities": 4}, "expected 4 severities"),
    ],
)
def test_a_wrong_suite_is_refused(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    whole = yaml.safe_load((ROOT / "transforms" / "lidar" / "robo3d.yaml").read_text(encoding="utf-8"))
    file = tmp_path / "suite.yaml"
    file.write_text(yaml.safe_dump({**whole, **change}))
    with pytest.raises(TorchweatherError, match=said):
        read_recipe(file, "suite")
