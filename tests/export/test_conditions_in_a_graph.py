"""Water and snow on things in exported graphs: the same numbers, or a refusal by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.atmosphere.condition_scene import CAMERA, LIDAR, RADAR, H, W, cloud, frame
from torchweather.atmosphere.conditions import RoadSpray, SnowCover, WetRoad, WetWindow
from torchweather.atmosphere.weather import Mixture, Rain
from torchweather.export import draw_feed, to_onnx
from torchweather.transforms import BayerWeather, LidarWeather, RadarAttenuation

SPRAY = RoadSpray(speed_m_per_s=25.0, distance_m=12.0, water_mm=2.0)
FOLLOWS = {"WetRoad": WetRoad(), "WetWindow": WetWindow(), "RoadSpray": RoadSpray(speed_m_per_s=20.0)}


@pytest.mark.parametrize("name", FOLLOWS)
@pytest.mark.parametrize("sensor", ["camera", "lidar", "radar"])
def test_what_follows_from_the_rain_is_refused(name: str, sensor: str, tmp_path: Path) -> None:
    weather = Mixture(Rain(10.0), FOLLOWS[name])
    built: dict[str, Any] = {
        "camera": lambda: BayerWeather(weather, CAMERA, airlight=0.7),
        "lidar": lambda: LidarWeather(weather, LIDAR),
        "radar": lambda: RadarAttenuation(weather, RADAR),
    }
    with pytest.raises(ValueError, match=rf"the rate is an input of the graph, and {name} follows .* Give {name}"):
        to_onnx(built[sensor](), tmp_path / "no.onnx")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_camera_graph_holds_road_snow_and_spray(tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    weather = Mixture(WetRoad(water_mm=1.0, puddles=0.5), SnowCover(depth_mm=3.0), SPRAY)
    transform = BayerWeather(weather, CAMERA, airlight=0.7)
    to_onnx(transform, tmp_path / "camera.onnx", height=H, width=W)
    image = frame((1,))
    depth = torch.full((1, 1, H, W), 30.0)
    depth[..., H // 2 :, :] = 150.0 / (torch.arange(H // 2).float()[:, None] + 0.5)
    noise = transform.draw(image, seed=4)
    session = onnxruntime.InferenceSession(str(tmp_path / "camera.onnx"), providers=["CPUExecutionProvider"])
    names = [one.name for one in session.get_inputs()]
    feed = {key: value.numpy() for key, value in noise.items() if key in names}
    feed |= {"bayer": image.numpy(), "depth": depth.numpy()}
    fx, fy, cx, cy = CAMERA.intrinsics
    feed |= {key: np.array([value], np.float32) for key, value in {"fx": fx, "fy": fy, "cx": cx, "cy": cy}.items()}
    missing = [name for name in names if name not in feed]
    feed |= {name: draw_feed(tmp_path / "camera.onnx", seed=4, height=H, width=W)[name] for name in missing}
    (found,) = session.run(["signal"], {name: feed[name] for name in names})
    assert np.allclose(found, transform(image, depth, noise).numpy(), atol=2e-4)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("sensor", ["lidar", "radar"])
def test_graphs_of_lidar_and_radar_hold_spray_and_windows(sensor: str, tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    weather = Mixture(SPRAY, WetWindow(speed_m_per_s=10.0, rain_mm_per_h=5.0))
    data = cloud()[None] if sensor == "lidar" else torch.tensor([[40.0, 0.8, 0.0, 0.0, -60.0, 10.0]]).repeat(1, 5, 1)
    transform: Any = LidarWeather(weather, LIDAR) if sensor == "lidar" else RadarAttenuation(weather, RADAR)
    to_onnx(transform, tmp_path / "graph.onnx")
    noise = transform.draw(data, seed=4)
    session = onnxruntime.InferenceSession(str(tmp_path / "graph.onnx"), providers=["CPUExecutionProvider"])
    names = [one.name for one in session.get_inputs()]
    feed = {name: (data if name == "points" else noise[name]).numpy() for name in names}
    found = session.run(None, feed)[0]
    assert np.allclose(found, transform(data, noise).numpy(), atol=1e-3)


@pytest.mark.parametrize("condition", [WetRoad(water_mm=1.0), SnowCover(depth_mm=5.0)])
def test_what_is_fitted_to_each_cloud_is_refused(condition: Any, tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    with pytest.raises(Exception, match="no graph can hold it, as it fits the ground to each cloud"):
        to_onnx(LidarWeather(condition, LIDAR), tmp_path / "no.onnx")


def test_drops_that_refract_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    with pytest.raises(Exception, match="CameraRefractingDrops: no graph can hold it"):
        to_onnx(BayerWeather(WetWindow(rain_mm_per_h=9.0), CAMERA, airlight=0.7), tmp_path / "no.onnx")
