"""Calls that random arguments once led into an internal error: each is refused by name, or has its right value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.fuzz import good_values as good
from torchweather.atmosphere.density_field import AZIMUTHS, NODES, PatchField, PatchyAir, mean_density, mean_extra_m
from torchweather.atmosphere.weather import Rain, weather_from_dict
from torchweather.camera.depth import (
    CompletedDepth,
    DepthFromPoints,
    ScenePrior,
    as_depth_source,
    find_horizon,
    project_points,
)
from torchweather.camera.depth.sparse import depth_from_disparity
from torchweather.camera.exposure import ExposureControl
from torchweather.camera.fog import ExtinctionAndAirlight
from torchweather.camera.hdr import HdrWeather
from torchweather.compose import Collate, collate_list
from torchweather.compose.batches import join_indexed
from torchweather.core.errors import TorchweatherError
from torchweather.core.random import sample_seeds
from torchweather.datasets import boxes_to_nuscenes, pose_from_carla
from torchweather.datasets.boxes import turned_back
from torchweather.evaluation.sweep.run import sweep
from torchweather.export import ImageToDetector
from torchweather.image import colour_matrix, normalise, white_balance
from torchweather.io import PointCloud, PointLabels, merge_kind, parsivel_area_mm2
from torchweather.lidar import estimate_pattern, scan_count_problem
from torchweather.lidar.effects.empirical import Empirical
from torchweather.lidar.scan import empty_beams
from torchweather.lidar.sweep.beam_ends import beam_ends
from torchweather.metrics import average_precision, cloud_scores, correlate, expected_trends, point_counts
from torchweather.physics import (
    InterpolationTable,
    axial_q_back,
    equal_visibility_rain_rate,
    flake_reflectivity,
    henyey_greenstein_per_sr,
    marshall_palmer,
    maxwell_garnett,
    precipitation_rate_mm_per_h,
    rehearse_fog,
    snow_attenuation_db_per_km,
    sphere_budget,
    water_refractive_index,
    wet_cover_loss_db,
    wet_cover_series_db,
)
from torchweather.radar import (
    CellAveragingCfar,
    Scatterers,
    beat_signal,
    car_scatterers,
    corner_reflector_rcs_m2,
    gathered,
    subdivide,
    triangle_field_m,
)
from torchweather.radar.attenuation import WetRadome
from torchweather.radar.power_map.map_detections import map_detections
from torchweather.radar.power_map.power_map import MapAxes
from torchweather.radar.power_map.scale import PowerScale
from torchweather.scenes import object_boxes
from torchweather.scenes import test_track as track
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import BayerWeather

CAMERA = Camera.from_intrinsics(20.0, 20.0, 7.5, 5.5, 16, 12)
RGB = torch.rand(2, 3, 4, 4)
SEEN = {"boxes": torch.tensor([[1.0, 1.0, 5.0, 6.0]]), "labels": ["car"], "scores": [0.9]}
TRUE = {"boxes": torch.tensor([[1.0, 1.0, 5.0, 6.0]]), "labels": ["car"]}
TRIANGLE = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.3]]])
TABLE = torch.zeros(1, AZIMUTHS + 1, NODES)
EMPIRICAL = {"kind": "gain", "axis": "object_range_m", "measured_from": 1.0, "measured_to": 50.0}


def pattern() -> Any:
    azimuth = np.radians(np.arange(0.0, 360.0))
    rows = [np.stack([9 * np.cos(azimuth), 9 * np.sin(azimuth), np.full(360, z)], -1) for z in (-1.0, 0.0)]
    return estimate_pattern(np.concatenate(rows))


def scatterers() -> Scatterers:
    return Scatterers.from_spherical(torch.tensor([20.0, 30.0]), 0.0, 0.0, rcs_dbsm=10.0)


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "rows of rows for a row": (
        lambda: Empirical(**EMPIRICAL, at=torch.ones(2, 3), value=[0.5]),
        "at must be a sequence of float",
    ),
    "no band": (
        lambda: ExtinctionAndAirlight({"kind": "fog", "mor_m": 50.0}, wavelengths_nm=[]),
        "wavelengths_nm must have one entry or more; got none",
    ),
    "drift of a tensor": (lambda: PatchyAir(50.0, torch.ones(2, 8, 8)), "drift_m_per_s must be a sequence of float"),
    "window of a tensor": (lambda: ExposureControl(window=torch.ones(3, 4)), "window must be a sequence of float"),
    "gain of a tensor": (lambda: ExposureControl(lowest_gain=torch.ones(2)), "lowest_gain must be a number"),
    "lists of other lengths": (
        lambda: weather_from_dict({"kind": "fog", "mor_m": [[1.0, 2.0], [3.0]]}),
        "mor_m must be a number or a tensor",
    ),
    "no place": (
        lambda: mean_density(TABLE, torch.zeros(1, 6), torch.zeros(0, 6), 1.0),
        "places must be of 1 samples or of one; got 0",
    ),
    "place that is no number": (
        lambda: mean_density(TABLE, torch.full((1, 6), torch.nan), torch.ones(1, 6), 1.0),
        "azimuth_rad must lie in",
    ),
    "depth of objects": (lambda: as_depth_source(np.array([None, 1])), "depth must be an array of real numbers"),
    "picture without colours": (lambda: find_horizon(torch.zeros(0, 12, 16), CAMERA), "expected one picture"),
    "points that are no numbers": (
        lambda: beam_ends(np.full((4, 3), np.nan), np.ones((1, 3)), 50.0),
        "points_xyz finite",
    ),
    "no rings": (lambda: scan_count_problem(pattern(), 0, rings=0), "rings must be 1 or more; got 0"),
    "attenuation of a batch": (
        lambda: beat_signal(scatterers(), Radar(), attenuation_db=torch.zeros(3, 2)),
        r"attenuation_db must broadcast to the scatterers \(2,\); got \(3, 2\)",
    ),
    "correlation in one row": (lambda: CellAveragingCfar(correlation=range(3)), "correlation must be a sequence of"),
    "cells beyond the earth": (lambda: gathered(scatterers(), 0.004, 2**64), "cell_m must lie in 1e-09..1e"),
    "endless triangles": (lambda: subdivide(TRIANGLE, 1e-6), "at most 4000000 triangles; got 1e-06 m"),
    "clouds of a number": (lambda: Collate(clouds=torch.tensor(1.0)), "clouds must be a sequence of keys"),
    "clouds that are none": (lambda: collate_list(range(3)), "clouds must be a sequence of real"),
    "complex colours": (lambda: colour_matrix(RGB, torch.ones(3, 3) * 1j), "matrix must be a number or a tensor"),
    "gains of another batch": (lambda: white_balance(RGB, torch.ones(4, 3)), "shapes must broadcast"),
    "columns of numbers": (lambda: PointCloud(torch.zeros(2, 3), range(3)), "columns must be a sequence of str"),
    "range of one end": (lambda: average_precision([SEEN], [TRUE], ranges_m=(7,)), "ranges_m must be pairs"),
    "labels in lists": (
        lambda: average_precision([{**SEEN, "labels": torch.ones(1, 1)}], [TRUE]),
        r"detections\[0\]: labels must be one name or number a box",
    ),
    "overlap of no boxes": (
        lambda: average_precision([SEEN], [TRUE], overlap=int),
        "overlap must take what it is called with; got <class 'int'>, which raises",
    ),
    "overlap of another shape": (
        lambda: average_precision([SEEN], [TRUE], overlap=lambda first, second: first),
        r"overlap must give a tensor \(1, 1\)",
    ),
    "one score for all levels": (
        lambda: expected_trends({"road": {"ssim": 1.0}}, {"ssim": "up"}),
        "road: ssim must have one entry per level; got 1.0",
    ),
    "direction of an array": (
        lambda: expected_trends({"road": {"ssim": [0.9, 0.5]}}, {"ssim": np.arange(4)}),
        "direction of ssim must be 'up'",
    ),
    "complex points": (lambda: point_counts(torch.ones(4, 4) * 1j), "points must be a tensor of real numbers"),
    "labels of tensors": (
        lambda: object_boxes(track(), torch.eye(4), (torch.ones(2),)),
        "labels must be a sequence of int",
    ),
    "glint at its focus": (lambda: axial_q_back(2.0), "must be below 2, where the rear glint has a focus; got 2"),
    "flakes lighter than nothing": (
        lambda: equal_visibility_rain_rate(1.0, density_g_per_cm3=-1.0),
        "density_g_per_cm3 must lie in 1e-06..1 g/cm3; got -1",
    ),
    "fall speed of no drops": (
        lambda: precipitation_rate_mm_per_h(marshall_palmer(10.0), fall_speed=int),
        "fall_speed must take what it is called with; got <class 'int'>",
    ),
    "no rate": (lambda: snow_attenuation_db_per_km(torch.zeros(0, 4)), "expected one distribution or more; got none"),
    "no wavelength": (
        lambda: water_refractive_index([], torch.zeros(2, 3)),
        r"shapes must broadcast; got wavelength_nm \(0,\), temperature_c \(2, 3\)",
    ),
    "covers of other shapes": (
        lambda: wet_cover_loss_db(torch.ones(3, 2), torch.zeros(2), 0.0, torch.ones(4), 0.5, 10.0),
        "shapes must broadcast; got",
    ),
    "pose of objects": (lambda: Lidar(905.0, origin_m=(np.array([None, 1]), 0.0, 0.0)), "Lidar.origin_m: expected"),
    "gap without an end": (
        lambda: empty_beams(torch.ones(3, 4), Lidar.preset("velodyne-hdl-64e"), max_gap_deg=float("inf")),
        "max_gap_deg must lie in",
    ),
    "complex rate": (lambda: WetRadome(torch.ones(2) * 1j), "rate_mm_per_h must be a number or a tensor of real"),
    "takes of no sample": (
        lambda: mean_extra_m(PatchField(torch.zeros(1, AZIMUTHS + 1, NODES), 1.0), [Rain(1.0)], [torch.tensor(1.5)]),
        r"takes must be a tensor \(B,\)",
    ),
    "complex cloud for depth": (
        lambda: CompletedDepth(torch.ones(4, 3) * 1j, torch.eye(4)),
        "points_xyz must be a tensor of real numbers",
    ),
    "pose of nothing": (
        lambda: DepthFromPoints(torch.ones(4, 3), [None]),
        "T_camera_from_lidar must be a tensor, an array or",
    ),
    "points beyond the earth": (
        lambda: project_points(torch.full((1, 3), 1e30), torch.eye(4), CAMERA),
        "points_xyz must lie in -1e",
    ),
    "car nowhere": (
        lambda: car_scatterers((torch.tensor([True, False]), 0.0), 0.0039),
        "rear_m must be a sequence of float",
    ),
    "facets of other directions": (
        lambda: triangle_field_m(TRIANGLE.expand(3, 3, 3), torch.eye(3)[0], torch.full((2,), 0.004)),
        "shapes must broadcast",
    ),
    "axes in lists": (lambda: MapAxes(("azimuth", []), (1.0, 2.0)), "dims must be a sequence of str"),
    "scale without a kind": (lambda: PowerScale.from_dict({}), "PowerScale: kind must be text; got None"),
    "colours out of range": (lambda: colour_matrix(RGB, torch.full((3, 3), 1e30)), "matrix must lie in -1e"),
    "transform with a shear": (
        lambda: boxes_to_nuscenes(good.boxes(), torch.diag(torch.tensor([1.0, 1.0, 1.0, 0.0]))),
        "rotation and metres above 0, 0, 0, 1",
    ),
    "complex pose": (
        lambda: pose_from_carla(np.eye(4) * (1 + 1j)),
        "transform must be a carla.Transform or its matrix",
    ),
    "score in a list": (
        lambda: cloud_scores(torch.ones(4, 3), torch.ones(4, 3), names=([None], "hd")),
        "names must be one of",
    ),
    "resamples beyond memory": (
        lambda: correlate({"ssim": [0.9, 0.5, 0.4]}, [0.9, 0.8, 0.1], resamples=10**30),
        "resamples must lie in 1..1e",
    ),
    "kinds beyond memory": (
        lambda: point_counts(torch.ones(4, 4), torch.zeros(4, dtype=torch.int64), kinds=2**64),
        "kinds must lie in 1..65536",
    ),
    "complex mean": (lambda: ImageToDetector(std=torch.ones(3) * 1j), "std must be a number or a tensor of real"),
    "function of no tensor": (
        lambda: InterpolationTable(len, 1.0, 2.0, 4),
        "values_of_function must be a tensor of real numbers; got 4",
    ),
    "mixture without a value": (lambda: maxwell_garnett(1.0, -2.0, 0.5), "permittivities with a mixture"),
    "drops of less than nothing": (
        lambda: axial_q_back(1.33 + 0.1j, diameter_mm=-1e30, wavelength_nm=905.0),
        "diameter_mm must be 0 or more|no quantity is as small or large|diameter_mm must be",
    ),
    "rain at no time": (
        lambda: wet_cover_loss_db(torch.tensor(0.0), torch.tensor(0.0), 0.0, 0.0, 0.5, 10.0),
        r"rain_mm_per_h must have shape \(\.\.\., 1 or more\)",
    ),
    "visibility in half metres": (lambda: rehearse_fog(np.array(10.5)), "nominal_mor_m must be a whole number"),
    "noise beyond all power": (
        lambda: map_detections(good.power_map(), Radar(), noise_db=1e30),
        "noise_db must lie in -400..400 dB",
    ),
    "axes of nothing": (lambda: MapAxes.from_dict({}), "expected dims and range_m, .*; got nothing"),
    "bins without edges": (
        lambda: weather_from_dict({"kind": "rain", "rate_mm_per_h": 1.0, "size_distribution": {"edges_mm": [1.0]}}),
        "size_distribution must have edges_mm, density_per_m3_mm, particle; got edges_mm",
    ),
    "film without bound": (
        lambda: wet_cover_loss_db(torch.ones(2), torch.zeros(2), 0.0, 1.0, 1000.0, 10.0),
        "film_exponent must lie in 0..5",
    ),
    "film dry at once": (
        lambda: wet_cover_series_db(torch.ones(2), torch.arange(2), 0.0, 1.0, 0.5, -0.0),
        "drying_min must lie in 0.001..1e",
    ),
    "takes of complex numbers": (
        lambda: mean_extra_m(PatchField(torch.zeros(1, AZIMUTHS + 1, NODES), 1.0), [Rain(1.0)], [torch.ones(1) * 1j]),
        r"takes must be a tensor \(B,\)",
    ),
    "focal length beyond the earth": (
        lambda: depth_from_disparity(torch.ones(3), 2**63, 1.0),
        "fx_px must lie in 0..1e",
    ),
    "points of one number": (lambda: DepthFromPoints(2**63, torch.eye(4)), "points_xyz must be a tensor, an array or"),
    "clouds of one number": (
        lambda: join_indexed([torch.tensor(1.0)], torch.zeros(0, 5)),
        r"clouds must be \(N, C\); got \(\)",
    ),
    "labels of one number": (
        lambda: average_precision([SEEN], [{**TRUE, "labels": np.array(2.0)}]),
        "labels must be a sequence",
    ),
    "grains of other shapes": (
        lambda: flake_reflectivity(torch.full((3,), 905.0), grain_radius_um=torch.full((2,), 100.0)),
        r"shapes must broadcast; got wavelength_nm \(3,\), grain_radius_um \(2,\)",
    ),
    "option of no camera": (
        lambda: BayerWeather(Rain(1.0), CAMERA, exposure_control={"statistc": "mean"}),
        "'statistc' is no option of ExposureControl. Did you mean 'statistic'",
    ),
    "option of no transform": (
        lambda: HdrWeather(Rain(1.0), CAMERA, exposures_s=(0.01, 0.001), dept=3.0),
        "'dept' is no option of BayerWeather. Did you mean 'depth'",
    ),
    "seeds that are no numbers": (
        lambda: sweep([], [], seeds=torch.ones(3)),
        "seeds must be a sequence of int",
    ),
    "levels that are none": (lambda: normalise(torch.ones(3), 0.0, 1e-320), "white_level must be above black_level"),
    "corners seen from elsewhere": (
        lambda: corner_reflector_rcs_m2(torch.ones(3), 0.004, to_radar=torch.ones(2, 3)),
        "shapes must broadcast",
    ),
    "samples beyond memory": (lambda: sample_seeds((10**30,)), "batch_shape must be of 2147483648 samples at most"),
    "sources of another batch": (
        lambda: merge_kind(PointLabels(torch.arange(4), torch.arange(4)), torch.zeros(3, 4), torch.zeros(3, 4)),
        "source must have the batch of labels",
    ),
    "takes of less than nothing": (
        lambda: mean_extra_m(
            PatchField(torch.zeros(1, AZIMUTHS + 1, NODES), 1.0), [Rain(1.0)], [torch.full((1,), -1.0)]
        ),
        "takes must lie in 0..1e",
    ),
    "gains out of range": (lambda: white_balance(RGB, [2.0, 1e300, 1.5]), "gains must lie in -1e"),
    "angles of another shape": (
        lambda: henyey_greenstein_per_sr(torch.zeros(4), torch.zeros(3)),
        "shapes must broadcast; got angle_rad",
    ),
    "headings turned upright": (
        lambda: turned_back(torch.zeros(1), torch.eye(3)[:, :2], torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])),
        "keeps headings level",
    ),
}


@pytest.mark.parametrize("call", REFUSED)
def test_refused_by_name(call: str) -> None:
    with pytest.raises(TorchweatherError, match=REFUSED[call][1]):
        REFUSED[call][0]()


@pytest.mark.parametrize("name", ["", ".", "/", ".."])
def test_a_folder_is_no_file_to_write(name: str) -> None:
    from torchweather.core.atomic import atomic_write

    with pytest.raises(TorchweatherError, match="it is a folder"), atomic_write(Path(name)):
        raise AssertionError


def test_densities_of_half_precision_read_the_same_places() -> None:
    table = torch.linspace(0.0, 30.0, (AZIMUTHS + 1) * NODES).reshape(1, AZIMUTHS + 1, NODES)
    azimuth, range_m = torch.linspace(-3.0, 3.0, 64)[None].half(), torch.linspace(1.0, 60.0, 64)[None].half()
    exact = mean_density(table, azimuth.double(), range_m.double(), 0.5)
    found = mean_density(table, azimuth, range_m, 0.5)
    assert found.dtype == torch.float16
    torch.testing.assert_close(found.double(), exact, rtol=2**-11, atol=0.0)
    mixed = mean_density(table, azimuth, range_m.float(), 0.5)
    torch.testing.assert_close(mixed.double(), exact, rtol=1e-6, atol=0.0)


def test_parts_of_a_triangle_cover_it_once() -> None:
    parts = subdivide(TRIANGLE.double(), 0.04)
    edges = parts[:, 1:] - parts[:, :1]
    area = 0.5 * torch.linalg.cross(edges[:, 0], edges[:, 1])
    assert len(parts) == 13**2  # 0.5 m in parts of 0.04 m
    torch.testing.assert_close(area, area[:1].expand_as(area))  # equal, and all turned alike
    torch.testing.assert_close(area.sum(0), torch.tensor([0.06, 0.0, 0.0], dtype=torch.float64))
    assert len(torch.unique(parts.mean(1).mul(1e6).round(), dim=0)) == len(parts)


def test_numbers_of_unusual_types() -> None:
    edges = torch.tensor([1.0, 3.0, 7.0])
    assert torch.equal(parsivel_area_mm2(edges.to(torch.uint16)), parsivel_area_mm2(edges))
    depth = np.full((12, 16), 20.0, ">f4")  # of another byte order
    assert as_depth_source(depth)(CAMERA, 12, 16).unique().tolist() == [20.0]
    assert ScenePrior(street_half_width_m=np.array(2.0)).street_half_width_m == (2.0, 2.0)
    assert find_horizon(torch.rand(3, 12, 16).bfloat16(), CAMERA).confidence >= 0.0
    assert colour_matrix(RGB, np.eye(3)).equal(RGB)
    assert white_balance(RGB[..., :0], (1.0, 2.0, 3.0)).shape == (2, 3, 4, 0)
    assert rehearse_fog(np.array(10)).sigma == rehearse_fog(10).sigma
    assert sphere_budget(torch.tensor(1.33)) == sphere_budget(float(torch.tensor(1.33)))
    half = triangle_field_m(TRIANGLE.half(), torch.tensor([1.0, 0.0, 0.0]).half(), 0.004)
    assert half.dtype == torch.complex64
    assert maxwell_garnett(1.0, 0.0, 0.5) == 0.4  # 2 (1 - f) / (2 + f)
