"""Valid arguments of public calls, by the name of the parameter: small, and new for each call."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather import io, metrics, physics, scenes
from torchweather.atmosphere.density_field import AZIMUTHS, NODES, PatchField
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.camera.depth import ConstantDepth, SceneDepth
from torchweather.core.random import Variate
from torchweather.datasets import Boxes
from torchweather.evaluation.sweep import CameraSubject, LidarSubject, parse_levels
from torchweather.lidar import estimate_pattern
from torchweather.radar import Scatterers
from torchweather.radar.power_map import MapAxes, PowerScale, RadarPowerMap
from torchweather.recipes import read_recipe
from torchweather.sensors import Camera, Lidar, Radar, scan_directions
from torchweather.transforms import BayerWeather, LidarWeather, RadarAttenuation

__all__ = ["BY_CALL", "BY_NAME", "CAMERA", "LIDAR", "RADAR", "cloud", "detections", "folder", "frame"]

H, W, N = 12, 16, 40
CAMERA = Camera.from_intrinsics(20.0, 20.0, 7.5, 5.5, W, H, exposure_s=0.005, height_m=1.6)
LIDAR = Lidar(wavelength_nm=905.0, intensity_unit="reflectivity")
RADAR = Radar.preset("imaging-77ghz", detection_snr_db=9.0)
SMALL_RADAR = Radar(samples=16, chirps=8)
AXES = MapAxes.of_turn(bins=24, bin_m=0.5, azimuths=20)
EYE = torch.eye(4, dtype=torch.float64)
CAMERA_AXES = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)


def _random(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def frame() -> Tensor:
    """A mosaic."""
    return 0.1 + 0.5 * torch.rand(1, H, W, generator=_random())


def image() -> Tensor:
    """An image of three colours."""
    return 0.1 + 0.5 * torch.rand(3, H, W, generator=_random())


def pair_image() -> Tensor:
    """An image large enough for every score."""
    return torch.rand(1, 1, 24, 24, generator=_random())


def cloud() -> Tensor:
    """A cloud of four columns at 3 to 40 m."""
    points = torch.randn(N, 4, generator=_random())
    points[:, :3] *= (3 + 37 * torch.rand(N, 1, generator=_random(1))) / points[:, :3].norm(dim=1, keepdim=True)
    points[:, 3] = torch.rand(N, generator=_random(2))
    return points


def detections() -> Tensor:
    """A list of radar detections."""
    points = torch.cat([cloud()[:, :3], torch.zeros(N, 3)], 1)
    points[:, 3], points[:, 4], points[:, 5] = 2.0, -80.0, 5.0
    return points


def rays() -> Tensor:
    """Directions of beams."""
    return torch.nn.functional.normalize(cloud()[:, :3], dim=-1)


def boxes() -> Boxes:
    """Two boxes."""
    place = torch.tensor([[10.0, 1, 0], [20, -2, 0]])
    return Boxes(place, torch.tensor([[4.0, 2, 1.5], [1, 1, 2]]), torch.tensor([0.1, 2.0]), ("Car", "Pedestrian"))


@cache
def folder() -> Path:
    """A folder with a file of most kinds; it is left to the system's temporary folder."""
    root = Path(tempfile.mkdtemp(prefix="fuzz-calls-"))
    io.write_image(root / "a.png", (255 * image()).to(torch.uint8))
    io.write_points(root / "a.bin", cloud())
    io.write_radar(root / "a.csv", detections())
    np.save(root / "a.npy", np.full((H, W), 9.0, np.float32))
    (root / "a.label").write_bytes(bytes(4 * N))
    (root / "a.txt").write_text("10\n10\n")
    io.write_adc(root / "adc.npy", torch.ones(2, 4, 8, dtype=torch.complex64))
    io.write_power_map(root / "map.npz", power_map())
    (root / "pose.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 1.8\n")
    (root / "P2.txt").write_text(
        "P2: 20 0 7.5 0 0 20 5.5 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
    )
    (root / "boxes.txt").write_text("Car 0 0 -1.57 10 10 20 20 1.6 1.8 4 0 1 20 -1.57\n")
    (root / "boxes.json").write_text(
        '[{"translation": [10, 1, 0], "size": [1.8, 4, 1.6], "rotation": [1, 0, 0, 0], "sample_token": "s"}]'
    )
    (root / "camera.json").write_text(
        '{"CAM_FRONT": {"cam2img": [[20, 0, 8], [0, 20, 6], [0, 0, 1]],'
        ' "lidar2cam": [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]}}'
    )
    (root / "coco.json").write_text(
        '{"images": [{"id": 1, "file_name": "a.png"}], "categories": [{"id": 3, "name": "car"}],'
        ' "annotations": [{"image_id": 1, "category_id": 3, "bbox": [1, 2, 3, 4]}]}'
    )
    io.write_points(root / "a.pcd.bin", torch.cat([cloud(), ring()[:, None].float()], 1))
    return root


def power_map() -> RadarPowerMap:
    """A map of bytes."""
    level = torch.randint(20, 120, AXES.shape, generator=_random(), dtype=torch.uint8)
    return RadarPowerMap(level, AXES, PowerScale.steps(0.5))


def scatterers() -> Scatterers:
    """Three targets."""
    return Scatterers.from_rcs(torch.tensor([[10.0, 0, 0], [15, 2, 0], [20, -3, 0]]), 10.0)


def _truths() -> list[dict[str, Any]]:
    return [{"boxes": torch.tensor([[1.0, 1, 5, 5]]), "labels": ["car"]}]


def _found() -> list[dict[str, Any]]:
    return [{"boxes": torch.tensor([[1.0, 1, 5, 6]]), "labels": ["car"], "scores": torch.tensor([0.7])}]


def ring() -> Tensor:
    """Rings of a cloud."""
    return torch.arange(N) % 4


def scene_depth() -> SceneDepth:
    """A scene at 20 m."""
    return SceneDepth(torch.full((1, H, W), 20.0))


def carla() -> Any:
    """A frame of CARLA."""
    return SimpleNamespace(raw_data=bytes(range(192)) * 4, width=W, height=H, fov=90.0)


def measurement() -> Any:
    """A cloud of CARLA."""
    return SimpleNamespace(raw_data=cloud().numpy().tobytes())


def _spinning() -> Lidar:
    """A LiDAR of 16 rings."""
    return Lidar.preset("velodyne-vlp-16", intensity_unit="reflectivity")


@cache
def _sweep() -> Tensor:
    """A sweep of it over flat ground."""
    rays = scan_directions(_spinning())[..., ::10, :].reshape(-1, 3)
    way = torch.where(rays[:, 2] < -0.05, -1.8 / rays[:, 2].clamp(max=-0.05), 30.0)
    return torch.cat([rays * way[:, None], torch.full((len(rays), 1), 0.3)], 1).float()


@cache
def _pattern() -> Any:
    return estimate_pattern(_sweep(), rings=16)


def _quiet_map() -> RadarPowerMap:
    """A map that holds little but noise."""
    axes = MapAxes.of_turn(bins=80, bin_m=0.5, azimuths=80)
    level = 40 + 10 * -torch.rand(axes.shape, generator=_random()).log()
    return RadarPowerMap(level.clamp(0, 255).to(torch.uint8), axes, PowerScale.steps(0.5))


def _lidar_subject() -> LidarSubject:
    return LidarSubject("a", points=cloud(), lidar=LIDAR)


def _level() -> Any:
    return parse_levels("rain:rate=5,10")[0]


BY_NAME: Mapping[str, Callable[[], Any]] = {
    # weather and sensors
    "weather": lambda: Rain(10.0),
    "weathers": lambda: [Rain(10.0)],
    "camera": lambda: CAMERA,
    "lidar": lambda: LIDAR,
    "radar": lambda: RADAR,
    "sensor": lambda: LIDAR,
    "transform": lambda: LidarWeather(Rain(10.0), LIDAR),
    "rate_mm_per_h": lambda: 10.0,
    "mor_m": lambda: 100.0,
    "nominal_mor_m": lambda: 30,
    "text": lambda: "rain:rate=5",
    # images
    "bayer": frame,
    "raw": frame,
    "linear": image,
    "rgb": image,
    "display": image,
    "planes": lambda: torch.rand(4, 6, 8),
    "image": image,
    "pattern": lambda: "RGGB",
    "distorted": pair_image,
    "reference": pair_image,
    "height": lambda: H,
    "width": lambda: W,
    "depth_m": lambda: torch.full((1, H, W), 20.0),
    "depth": lambda: torch.full((1, H, W), 20.0),
    "knots": lambda: [(0.0, 0.0), (0.5, 0.8), (1.0, 1.0)],
    "gains": lambda: [2.0, 1.0, 1.5],
    "fx": lambda: 20.0,
    "fy": lambda: 20.0,
    "cx": lambda: 7.5,
    "cy": lambda: 5.5,
    "horizontal_rad": lambda: 1.0,
    "vertical_rad": lambda: 0.8,
    "top": lambda: 2,
    "left": lambda: 2,
    "dtype": lambda: torch.float32,
    "share": lambda: torch.zeros(H, W),
    "disparity_px": lambda: torch.full((1, H, W), 4.0),
    "fx_px": lambda: 700.0,
    "baseline_m": lambda: 0.5,
    "matrix": lambda: torch.eye(3),
    "source": lambda: ConstantDepth(20.0),
    "function": lambda: torch.exp,
    "confidences": lambda: "exact",
    "normal": lambda: torch.zeros(1, 3, H, W),
    # points
    "points": cloud,
    "points_xyz": lambda: cloud()[:, :3],
    "cloud": cloud,
    "clouds": lambda: [cloud(), cloud()[:7]],
    "T_camera_from_lidar": lambda: EYE,
    "T_rectified_from_lidar": lambda: EYE,
    "pose": lambda: EYE,
    "kind": lambda: torch.zeros(N, dtype=torch.int64),
    "directions": rays,
    "direction": rays,
    "ring": ring,
    "x": lambda: torch.linspace(-0.3, 0.3, 5),
    "y": lambda: torch.linspace(-0.2, 0.2, 5),
    "range_m": lambda: torch.linspace(5.0, 50.0, 6),
    "azimuth_rad": lambda: torch.linspace(-1.0, 1.0, 6),
    "elevation_rad": lambda: torch.linspace(-0.1, 0.1, 6),
    "boxes": boxes,
    "labels": lambda: io.PointLabels(torch.zeros(N, dtype=torch.int64), torch.zeros(N, dtype=torch.int64)),
    "points_before": cloud,
    "result_points": cloud,
    "transmission": lambda: torch.ones(N),
    "mask": lambda: torch.ones(2, N, dtype=torch.bool),
    "like": lambda: torch.zeros(1),
    "T_lidar_from_boxes": lambda: EYE,
    "visibility": lambda: None,
    "detections": detections,
    "annotations": lambda: [{"translation": [1.0, 2, 3], "size": [1.0, 2, 1], "rotation": [1.0, 0, 0, 0]}],
    "measurement": measurement,
    "columns": lambda: {"a": [1, 2], "b": ["x", None]},
    "clear": lambda: 0.8,
    # random numbers
    "seed": lambda: 3,
    "seeds": lambda: [1, 2],
    "key": lambda: "a.png",
    "stream": lambda: "rain",
    "batch_shape": lambda: (2,),
    "sizes": lambda: {"height": H, "width": W, "points": N},
    "u": lambda: 0.3,
    "stage": lambda: "rain",
    "law": lambda: "uniform",
    "variates": lambda: [Variate("a", "uniform", (3,))],
    "sample_token": lambda: None,
    "values": lambda: [1.0, 2.0],
    # physics
    "distribution": lambda: physics.marshall_palmer(10.0),
    "wavelength_nm": lambda: 905.0,
    "frequency_ghz": lambda: 77.0,
    "diameter_mm": lambda: torch.tensor([0.5, 1.0, 3.0]),
    "refractive_index": lambda: 1.33 + 1e-6j,
    "size_parameter": lambda: 5.0,
    "extinction_per_m": lambda: 0.03,
    "liquid_water_g_per_m3": lambda: 0.1,
    "q_eff": lambda: 0.8,
    "temperature_c": lambda: 5.0,
    "melted_mm": lambda: torch.tensor([1.0, 2.0]),
    "physical_mm": lambda: torch.tensor([2.0, 4.0]),
    "melt_fraction": lambda: 0.3,
    "number_per_cm3": lambda: 100.0,
    "median_radius_um": lambda: 3.0,
    "sigma": lambda: 0.4,
    "intercept_per_m3_mm": lambda: 8000.0,
    "slope_per_mm": lambda: 3.0,
    "shape": lambda: 1.0,
    "alpha": lambda: 2.0,
    "gamma": lambda: 1.0,
    "mode_radius_um": lambda: 3.0,
    "density_per_m3_mm": lambda: torch.tensor([100.0, 50.0]),
    "edges_mm": lambda: torch.tensor([0.5, 1.0, 2.0]),
    "transmit_power_dbm": lambda: 12.0,
    "antenna_gain_dbi": lambda: 13.0,
    "rcs_dbsm": lambda: 10.0,
    "power_dbm": lambda: -80.0,
    "bandwidth_hz": lambda: 1e6,
    "density_g_per_cm3": lambda: 0.2,
    "snowfall_mm_per_h": lambda: 2.0,
    "volume_fraction": lambda: 0.2,
    "inclusion": lambda: 1.3 + 0j,
    "low": lambda: 1.0,
    "high": lambda: 10.0,
    "rain_mm_per_h": lambda: torch.tensor([0.0, 5.0, 2.0]),
    "time_min": lambda: torch.tensor([0.0, 1.0, 2.0]),
    "age_min": lambda: torch.tensor([0.0, 1.0, 2.0]),
    "loss_db": lambda: 1.0,
    "film_db": lambda: 2.0,
    "film_exponent": lambda: 0.3,
    "drying_min": lambda: 10.0,
    "row": lambda: "1",
    "name": lambda: "rain",
    "size_distribution": lambda: "default",
    "melted_diameter_mm": lambda: torch.tensor([1.0, 2.0]),
    "physical_diameter_mm": lambda: torch.tensor([2.0]),
    # radar
    "scatterers": scatterers,
    "power_map": power_map,
    "axes": lambda: AXES,
    "scale": lambda: PowerScale.steps(0.5),
    "cube": lambda: torch.ones(
        SMALL_RADAR.virtual_channels if hasattr(SMALL_RADAR, "virtual_channels") else 1, 8, 16, dtype=torch.complex64
    ),
    "edge_m": lambda: 0.3,
    "wavelength_m": lambda: 0.0039,
    "base_m": lambda: 0.3,
    "height_m": lambda: 0.3,
    "angle_rad": lambda: 0.1,
    "vertices_m": lambda: torch.tensor([[[10.0, 0, 0], [10, 1, 0], [10, 0, 1]]]),
    "to_radar": lambda: torch.tensor([[-1.0, 0, 0]]),
    "radar_position_m": lambda: torch.zeros(3),
    "velocity_m_per_s": lambda: torch.zeros(3),
    "facing": lambda: torch.tensor([-1.0, 0, 0]),
    "position_m": lambda: torch.tensor([[10.0, 0, 0]]),
    "max_edge_m": lambda: 0.5,
    "cell_m": lambda: 0.5,
    "rear_m": lambda: (10.0, 0.0),
    "oversampling": lambda: 1.5,
    "power": lambda: torch.rand(24, 24, generator=_random()),
    # scores
    "names": lambda: ("psnr",),
    "first": lambda: torch.tensor([[0.0, 0, 4, 4]]),
    "second": lambda: torch.tensor([[1.0, 0, 4, 4]]),
    "simulated": lambda: torch.rand(20, generator=_random()),
    "measured": lambda: torch.rand(20, generator=_random(1)),
    "scores": lambda: {"psnr": [20.0, 25.0, 30.0, 33.0], "ssim": [0.5, 0.6, 0.7, 0.9]},
    "performance": lambda: [0.3, 0.4, 0.6, 0.7],
    # files
    "path": lambda: folder() / "a.png",
    "scene": scenes.test_track,
    "title": lambda: "a title",
    "owner": lambda: "fuzz",
    "levels": lambda: [_level()],
    "allowed": lambda: ["rain", "fog"],
    "subjects": lambda: [CameraSubject("a", frame(), torch.full((1, H, W), 20.0), CAMERA)],
}

_NUMPY = lambda make: lambda: make().double().numpy()  # noqa: E731
_FILE = lambda name: lambda: folder() / name  # noqa: E731
_CLOUDS = lambda: [cloud()[None, :, :3], cloud()[None, :, :3] + 0.01]  # noqa: E731

BY_CALL: Mapping[str, Callable[[], Any]] = {
    "joss_rain.kind": lambda: "widespread",
    "deirmendjian_rain.name": lambda: "deirmendjian-rain-l",
    "of_beams.beams": lambda: 4,
    "CameraLidarCalibration.camera_matrix": lambda: torch.eye(3),
    "CameraLidarCalibration.T_camera_from_lidar": lambda: EYE,
    **{
        f"{owner}.{method}.points": make
        for owner, make in {"RadarAttenuation": detections, "RadarClutter": detections}.items()
        for method in ("forward", "run", "draw", "state_of")
    },
    "RadarAttenuation.on_numpy.points": lambda: detections().numpy(),
    "LidarRain.on_numpy.points": lambda: cloud().numpy(),
    **{f"RadarMapWeather.{method}.values": lambda: power_map().values for method in ("forward", "run", "draw")},
    **{f"Compose.{method}.sample": lambda: {"points": cloud()} for method in ("forward", "run", "draw")},
    **{f"BayerFog.{method}.bayer": frame for method in ("forward", "run", "draw", "state_of")},
    "Exponential.within.diameter_min_mm": lambda: 0.5,
    "Exponential.within.diameter_max_mm": lambda: 5.0,
    "MapAxes.axis.name": lambda: "range",
    "Boxes.select.keep": lambda: torch.tensor([True, False]),
    "Camera.preset.name": lambda: "lucid-triton",
    "Lidar.preset.name": lambda: "velodyne-vlp-16",
    "Radar.preset.name": lambda: "imaging-77ghz",
    "Camera.from_dict.values": lambda: {"width": 16, "height": 12, "fx": 20.0, "fy": 20.0},
    "Lidar.from_dict.values": lambda: {"wavelength_nm": 905.0},
    "Radar.from_dict.values": lambda: {"frequency_ghz": 77.0},
    "at_ego_speed.ego_speed_m_per_s": lambda: 0.0,
    "Lamp.position_m": lambda: (10.0, 0.0, 1.0),
    "RadialSpeed.sensor": lambda: Lidar(wavelength_nm=905.0, speed_column=4),
    "henyey_greenstein_per_sr.asymmetry": lambda: 0.8,
    "mie_phase_function_per_sr.distribution": lambda: physics.default_fog(50.0),
    "MapAxes.speed_m_per_s": lambda: None,
    "bayer_scores.names": lambda: ("psnr",),
    "image_scores.names": lambda: ("psnr", "ssim"),
    "bayer_scores.distorted": lambda: frame()[None].repeat(1, 1, 3, 2),
    "bayer_scores.reference": lambda: frame()[None].repeat(1, 1, 3, 2) + 0.01,
    "conditions_of.source": lambda: read_recipe("camera/robustness"),
    "read_boxes_truth.path": lambda: folder() / "coco.json",
    "read_boxes_truth.classes": lambda: {0: "car"},
    "read_label_truth.folder": folder,
    "read_label_truth.stem": lambda: "a",
    "read_label_truth.sensor": lambda: "lidar",
    "read_label_truth.shape": lambda: (N,),
    "object_boxes.sensor_from_vehicle": lambda: EYE,
    "sphere_budget.refractive_index": lambda: 1.33,
    **{f"check_{name}.value": lambda: 2.0 for name in ("at_least", "between", "finite", "positive")},
    "check_one_of.value": lambda: "rain",
    "sweep.subjects": lambda: [_lidar_subject()],
    "samples.subjects": lambda: [_lidar_subject()],
    "sweep.names": lambda: ("rmse",),
    "samples.names": lambda: ("rmse",),
    "empty_beams.lidar": _spinning,
    "recover_ring.lidar": _spinning,
    "own_vehicle_mask.sensor": _spinning,
    "empty_beams.points": _sweep,
    "recover_ring.points": _sweep,
    "estimate_elevations.points": _sweep,
    "estimate_elevations.rings": lambda: 16,
    "estimate_pattern.points": _sweep,
    "estimate_pattern.rings": lambda: 16,
    "fit_pattern.clouds": lambda: [_sweep()],
    "fit_pattern.rings": lambda: 16,
    "own_vehicle_mask.clouds": lambda: [_sweep() + 0.01 * k for k in range(6)],
    "mean_extra_m.patches": lambda: PatchField(torch.randn(1, AZIMUTHS + 1, NODES), 10.0),
    "mean_extra_m.weathers": lambda: [Fog(50.0, patch_log_std=0.5)],
    "mean_extra_m.takes": lambda: [torch.tensor([0.03])],
    "mean_density.extra_m": lambda: torch.zeros(1, AZIMUTHS + 1, NODES),
    "mean_density.step_m": lambda: 10.0,
    "mean_density.range_m": lambda: torch.linspace(5.0, 50.0, 6)[None],
    "mean_density.azimuth_rad": lambda: torch.linspace(-1.0, 1.0, 6)[None],
    "Banks.density": lambda: torch.ones(1, AZIMUTHS + 1, NODES),
    "Banks.extra_m": lambda: torch.zeros(1, AZIMUTHS + 1, NODES),
    "BanksAlongBeams.density": lambda: torch.ones(6, NODES),
    "BanksAlongBeams.extra_m": lambda: torch.zeros(6, NODES),
    "of_beams.values": lambda: torch.rand(2, 3),
    "PatchyAir.length_m": lambda: 30.0,
    "check_scan_counts.pattern": _pattern,
    "check_scan_counts.appended": lambda: 10,
    "scan_count_problem.pattern": _pattern,
    "scan_count_problem.appended": lambda: 10,
    "OwnVehicleMask.blocked": lambda: np.zeros((4, 8), bool),
    "OwnVehicleMask.nearest_m": lambda: np.ones((4, 8), np.float32),
    "OwnVehicleMask.farthest_m": lambda: np.ones((4, 8), np.float32),
    "corner_scatterers.facing": lambda: torch.tensor([[-1.0, 0, 0]]),
    "corner_scatterers.edge_m": lambda: torch.tensor([0.3]),
    "MapAxes.elevation_rad": lambda: None,
    "with_noise_scale.power_map": _quiet_map,
    "noise_correlation.power_map": _quiet_map,
    "noise_floor_db.power_map": _quiet_map,
    "join_indexed.clouds": lambda: [torch.cat([torch.zeros(N, 1), cloud()], 1)],
    "join_indexed.like": lambda: torch.cat([torch.zeros(N, 1), cloud()], 1),
    "PointCloud.columns": lambda: ("x", "y", "z", "intensity"),
    "PointLabels.classes": lambda: torch.arange(4),
    "PointLabels.instances": lambda: torch.arange(4),
    "RadarPoints.points": detections,
    "RadarPoints.columns": lambda: io.RADAR_COLUMNS,
    "with_labels_of.cloud": lambda: io.read_points(folder() / "a.bin"),
    "with_labels_of.kind": lambda: torch.zeros(N, dtype=torch.int64),
    "Boxes.centre_m": lambda: torch.zeros(2, 3),
    "Boxes.size_m": lambda: torch.ones(2, 3),
    "Boxes.yaw_rad": lambda: torch.zeros(2),
    "Boxes.names": lambda: ("Car", "Car"),
    "CarlaRig.sensors": lambda: {"points": "lidar"},
    "CarlaRig.transform": lambda: lambda sample: sample,
    "read_camera.width": lambda: W,
    "read_camera.height": lambda: H,
    "read_camera_fields.width": lambda: W,
    "read_camera_fields.height": lambda: H,
    "read_kitti_boxes.path": lambda: folder() / "boxes.txt",
    "read_nuscenes_boxes.path": lambda: folder() / "boxes.json",
    "read_nuscenes_calibration.path": lambda: folder() / "camera.json",
    "read_nuscenes_points.path": lambda: folder() / "a.pcd.bin",
    "update_boxes.points": cloud,
    "bev_iou.first": lambda: torch.tensor([[0.0, 0, 4, 2, 0.1]]),
    "bev_iou.second": lambda: torch.tensor([[1.0, 0, 4, 2, 0.3]]),
    "columns_of.found": list,
    "series_of.found": list,
    "write_kitti_boxes.T_rectified_from_lidar": lambda: CAMERA_AXES,
    "read_kitti_boxes.T_rectified_from_lidar": lambda: CAMERA_AXES,
    **{
        f"{kind}.{name}": value
        for kind in ("BayerRain", "BayerFog", "BayerSnow", "BayerWeather")
        for name, value in {"camera": lambda: CAMERA}.items()
    },
    "BayerFog.weather": lambda: Fog(50.0),
    "LidarFog.weather": lambda: Fog(50.0),
    "BayerSnow.weather": lambda: Snow(1.0),
    "LidarSnow.weather": lambda: Snow(1.0),
    "AsBayer.transform": lambda: BayerWeather(Fog(50.0), CAMERA, depth=20.0),
    "RadarAttenuation.sensor": lambda: RADAR,
    "RadarMapWeather.sensor": lambda: RADAR,
    "map_cfar.sensor": lambda: RADAR,
    "map_detections.sensor": lambda: RADAR,
    "map_state.sensor": lambda: RADAR,
    "map_state.values": lambda: torch.rand(1, *AXES.shape),
    "MapClutter.sensor": lambda: RADAR,
    "PathAttenuation.sensor": lambda: RADAR,
    "RadarDetection.sensor": lambda: RADAR,
    "VolumeClutter.sensor": lambda: RADAR,
    "ParticleVeil.camera": lambda: CAMERA,
    "ExtinctionAndAirlight.weather": lambda: Fog(50.0),
    "ExtinctionAndAirlight.wavelengths_nm": lambda: [460.0, 530.0, 600.0],
    "Mixture.weathers": lambda: Rain(5.0),
    "rehearse_fog.nominal_mor_m": lambda: 30,
    "deirmendjian_fog.name": lambda: "chu-hogg",
    "brandes_table4.row": lambda: "2.59",
    "beam_ends.points_xyz": _NUMPY(lambda: cloud()[:, :3]),
    "beam_ends.direction": _NUMPY(rays),
    "beam_ends.max_range_m": lambda: 100.0,
    "fit_ground.points_xyz": _NUMPY(lambda: cloud()[:, :3]),
    "fit_near_response.signal": lambda: torch.rand(N),
    "fit_near_response.reflectivity": lambda: torch.rand(N),
    "fit_near_response.range_m": lambda: torch.linspace(1, 30, N),
    "chamfer_distance.distorted": lambda: _CLOUDS()[0],
    "chamfer_distance.reference": lambda: _CLOUDS()[1],
    "cloud_scores.distorted": lambda: _CLOUDS()[0],
    "cloud_scores.reference": lambda: _CLOUDS()[1],
    "cloud_scores.names": lambda: ("rmse", "hd"),
    "sdm.distorted": lambda: _CLOUDS()[0],
    "sdm.reference": lambda: _CLOUDS()[1],
    "shape_signature_distance.distorted": lambda: _CLOUDS()[0],
    "shape_signature_distance.reference": lambda: _CLOUDS()[1],
    "CloudScore.name": lambda: "rmse",
    "BayerScore.name": lambda: "ssim",
    "ImageScore.facts": lambda: metrics.IMAGE_SCORES["ssim"],
    "point_counts.kind": lambda: torch.zeros(N, dtype=torch.int64),
    "average_precision.detections": _found,
    "average_precision.truths": _truths,
    "expected_trends.scores": lambda: {"a": {"ssim": [0.9, 0.8]}},
    "expected_trends.direction": lambda: {"ssim": "up"},
    "rates.weathers": lambda: {"rain": [0.5, 0.4]},
    "rates.clear": lambda: 0.8,
    "read_image.path": _FILE("a.png"),
    "read_points.path": _FILE("a.bin"),
    "read_radar.path": _FILE("a.csv"),
    "read_depth.path": _FILE("a.npy"),
    "read_labels.path": _FILE("a.label"),
    "read_adc.path": _FILE("adc.npy"),
    "read_power_map.path": _FILE("map.npz"),
    "read_sensor_pose.path": _FILE("pose.txt"),
    "read_sensor_points.path": _FILE("a.bin"),
    "read_camera.path": _FILE("P2.txt"),
    "read_camera_fields.path": _FILE("P2.txt"),
    "read_kitti_calibration.path": _FILE("P2.txt"),
    "read_kitti_rectified_from_lidar.path": _FILE("P2.txt"),
    "read_kitti_points.path": _FILE("a.bin"),
    "read_exif_focal.path": _FILE("a.png"),
    "read_table.path": _FILE("a.csv"),
    "write_image.path": _FILE("out.png"),
    "write_image.image": lambda: (255 * image()).to(torch.uint8),
    "write_points.path": _FILE("out.pcd"),
    "write_radar.path": _FILE("out.csv"),
    "write_table.path": _FILE("out-table.csv"),
    "write_labels.path": _FILE("out.label"),
    "write_adc.path": _FILE("out-adc.npz"),
    "write_adc.frame": lambda: torch.ones(2, 4, 8, dtype=torch.complex64),
    "write_power_map.path": _FILE("out-map.npz"),
    "write_kitti_boxes.path": _FILE("out-boxes.txt"),
    "write_nuscenes_boxes.path": _FILE("out-boxes.json"),
    "save_recipe.path": _FILE("out.yaml"),
    "image_from_carla.image": carla,
    "depth_from_carla.image": carla,
    "camera_from_carla.image": carla,
    "detections_from_carla.radar": lambda: RADAR,
    "pose_from_carla.transform": lambda: np.eye(4),
    "points_to_carla.kind": lambda: None,
    "depth_to_carla.depth_m": lambda: torch.full((1, H, W), 20.0),
    "image_to_carla.rgb": lambda: (255 * image()).to(torch.uint8),
    "merge_kind.kind": lambda: torch.zeros(N, dtype=torch.int64),
    "label_columns.cloud": lambda: io.read_points(folder() / "a.bin"),
    "update_boxes.result": lambda: None,
    "Sky.found": lambda: True,
    "spectrum_from_counts.counts": lambda: torch.ones(2, 2, 3),
    "spectrum_from_counts.speed_m_per_s": lambda: torch.tensor([1.0, 3.0, 5.0]),
    "spectrum_from_counts.area_mm2": lambda: torch.full((2,), 5000.0),
    "spectrum_from_counts.time_s": lambda: torch.tensor([0.0, 60.0]),
    "spectrum_from_counts.duration_s": lambda: 60.0,
    "spectrum_from_drops.speed_m_per_s": lambda: torch.tensor([2.0, 4.0, 8.0]),
    "spectrum_from_drops.area_mm2": lambda: torch.full((3,), 5000.0),
    "spectrum_from_drops.time_s": lambda: torch.tensor([0.0, 1.0, 70.0]),
    "spectrum_from_drops.duration_s": lambda: 60.0,
    "Compose.transforms": lambda: {"points": LidarWeather(Rain(10.0), LIDAR)},
    "Choice.values": lambda: [1.0, 2.0],
    "effect_from_dict.values": lambda: {"effect": "lidar.window_loss", "loss_db": 1.0},
    "weather_from_dict.values": lambda: {"kind": "fog", "mor_m": 30.0},
    "sensor_preset.text": lambda: "camera:lucid-triton",
    "parse_levels.text": lambda: "rain:rate=5,10",
    "load_recipe.name_or_path": lambda: "camera/fog-30m",
    "read_recipe.name_or_path": lambda: "camera/fog-30m",
    "read_recipe.kind": lambda: None,
    "list_recipes.kind": lambda: None,
    "map_layout.name_or_path": lambda: "radiate",
    "with_effects.chain": lambda: RadarAttenuation(Rain(10.0), RADAR).chain,
    "with_effects.effects": list,
    "least_sure.confidences": lambda: "exact",
    "weather_attenuation_db_per_km.radar": lambda: RADAR,
    "box_iou.first": lambda: torch.tensor([[0.0, 0, 4, 4]]),
    "Empirical.kind": lambda: "intensity",
    "Empirical.measured_from": lambda: 1.0,
    "Empirical.measured_to": lambda: 50.0,
    "Empirical.axis": lambda: "range_m",
    "Empirical.at": lambda: [5.0, 20.0],
    "Empirical.value": lambda: [1.0, 0.9],
    "InterpolationTable.low": lambda: 1.0,
    "PatchField.normal": lambda: torch.randn(1, AZIMUTHS + 1, NODES),
    "PatchField.step_m": lambda: 10.0,
    "patchy_air.weather": lambda: Fog(50.0, patch_log_std=0.5),
    "split_padded.points": lambda: torch.rand(2, N, 4),
    "split_indexed.points": lambda: torch.cat([torch.zeros(N, 1), cloud()], 1),
    "split_indexed.n_samples": lambda: 1,
    "beat_signal.radar": lambda: SMALL_RADAR,
    "range_doppler.radar": lambda: SMALL_RADAR,
    "range_doppler_angle.radar": lambda: SMALL_RADAR,
    "FmcwRadar.radar": lambda: SMALL_RADAR,
    "RangeDopplerMap.radar": lambda: SMALL_RADAR,
    "Scatterers.field_m": lambda: torch.ones(3, dtype=torch.complex64),
    "Scatterers.position_m": lambda: scatterers().position_m,
    "Scatterers.speed_m_per_s": lambda: torch.zeros(3),
    "corner_reflector_rcs_m2.to_radar": lambda: None,
    "check_depth.depth_m": lambda: torch.full((1, H, W), 20.0),
    "scan_directions.lidar": lambda: Lidar.preset("velodyne-vlp-16", intensity_unit="reflectivity"),
    "same_aspect.width": lambda: 16.0,
    "DepthMap.depth_m": lambda: torch.full((1, H, W), 20.0),
    "along_ray_to_axis.depth_m": lambda: torch.full((1, H, W), 20.0),
    "ConstantDepth.depth_m": lambda: 20.0,
    "lidar_view.lidar": lambda: Lidar.preset("velodyne-vlp-16", intensity_unit="reflectivity", columns=90),
    "find_sky.rgb": image,
    "RadarPowerMap.values": lambda: power_map().values,
    "PowerScale.kind": lambda: "linear",
    "MapAxes.dims": lambda: ("azimuth", "range"),
    "MapAxes.range_m": lambda: (1.0, 2.0, 3.0),
    "MapAxes.azimuth_rad": lambda: (0.0, 0.5, 1.0),
    "LogUniform.low": lambda: 1.0,
    "Uniform.low": lambda: 1.0,
    "Variate.shape": lambda: (3,),
    "draw_variates.stage": lambda: "rain",
    "RandomRain.rate_mm_per_h": lambda: (1.0, 50.0),
    "RandomFog.mor_m": lambda: (30.0, 300.0),
}
