"""A graph for a LiDAR whose fourth column has no meaning: particles take an object's value there, too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from torchweather.atmosphere.weather import Snow
from torchweather.export import draw_feed, to_onnx
from torchweather.sensors import Lidar
from torchweather.transforms import LidarSnow


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_graph_gives_particles_the_values_that_torch_gives_them(tmp_path: Path) -> None:
    lidar = Lidar(wavelength_nm=905.0, intensity_unit="none", near_start_m=0.5, near_full_m=1.0)
    snow = LidarSnow(Snow(3.0, flake_reflectivity=0.9), lidar, beam_ends="max_range")
    to_onnx(snow, tmp_path / "snow.onnx", points=100, directions=True)
    session = onnxruntime.InferenceSession(tmp_path / "snow.onnx", providers=["CPUExecutionProvider"])
    generator = torch.Generator().manual_seed(1)
    along = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=-1)
    values = torch.randint(1, 200, (500, 1), generator=generator).float()
    points = torch.cat([20.0 * along, values], -1)[None]
    points[:, ::3] = 0.0
    noise = draw_feed(session, points=500, seed=[3])
    given = {"points": points.numpy(), "directions": along.numpy(), "rate_mm_per_h": np.full(1, 3.0, np.float32)}
    cloud, kind = session.run(["cloud", "kind"], {**given, **noise})
    wanted = snow.run(points, {key: torch.from_numpy(value) for key, value in noise.items()}, directions=along)
    same = kind == np.asarray(wanted.kind)
    assert same.mean() > 0.99
    assert (kind == 1).sum() > 100
    np.testing.assert_allclose(cloud[same], np.asarray(wanted.points)[same], atol=1e-3)
