"""Completed sweeps of KITTI (HDL-64E) and pairs of WADS: what the recordings themselves say. Skipped without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.recordings import recording
from torchweather.atmosphere.weather import Snow
from torchweather.datasets import read_kitti_points
from torchweather.lidar import BeamEnd, ScanPattern, estimate_pattern, fit_ground
from torchweather.lidar.sweep.echo_pairs import first_rows
from torchweather.sensors import Lidar, recover_ring
from torchweather.stages import PointKind
from torchweather.transforms import LidarSnow

pytestmark = pytest.mark.real_data

KITTI = (
    *("000000", "000001", "000002", "000004", "000005", "000006", "000008"),
    *("000015", "000019", "000020", "000021", "000076", "001545"),
)


EVERY_TIME = ("000001", "000008", "000019")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in EVERY_TIME else [pytest.mark.long]) for name in KITTI]
)
def test_a_kitti_sweep_is_completed_to_one_turn_and_no_flake_lies_under_the_road(name: str) -> None:
    cloud = read_kitti_points(recording(f"kitti_13/velodyne/{name}.bin"))
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    snow = LidarSnow(Snow(rate_mm_per_h=1.0, flake_reflectivity=0.9), sensor, complete_scan=True)
    result = snow.run(cloud, snow.draw(cloud, seed=1))
    assert isinstance(result.kind, Tensor)
    assert isinstance(result.points, Tensor)
    assert isinstance(result.source, Tensor)
    assert isinstance(result.beam_end, Tensor)
    pattern = estimate_pattern(cloud[:, :3])
    # The motor's speed differs from sweep to sweep: 2151 to 2168 columns.
    missing = pattern.rings * pattern.columns - len(cloud)
    appended = len(result.kind) - len(cloud)
    assert appended == pytest.approx(missing, rel=0.03)
    ground = fit_ground(cloud.numpy())
    assert ground is not None
    flake = result.kind == PointKind.PARTICLE
    assert int(flake.sum()) > 3000
    places = result.points[flake][:, :3].double().numpy()
    assert ground.height_above(places).min() > -0.3
    # Of the same car, the beams that meet it: 8,900 on the sweeps without anything beside it.
    own = int((result.beam_end == int(BeamEnd.OWN_VEHICLE)).sum())
    assert 7000 < own < 10_500
    # The ring of every flake follows from where it lies: beams of the sweep give theirs by the order of the rows.
    row_ring = torch.from_numpy(pattern.ring)
    source = result.source[flake]
    nearest = _nearest_cone(places, pattern)
    from_rows = (source >= 0).numpy()
    same: np.ndarray = nearest[from_rows] == row_ring[source].numpy()[from_rows]
    assert same.mean() > 0.999
    elevation_off = _off_nearest_cone(places, pattern)
    assert np.quantile(elevation_off, 0.999) < 0.05, "degrees; rings are 0.3 to 0.7 apart"


def _cone_distances(places: np.ndarray, pattern: ScanPattern) -> np.ndarray:
    flat = np.hypot(places[:, 0], places[:, 1])
    elevation = np.degrees(np.arctan2(places[:, 2, None] - pattern.heights_m, flat[:, None]))
    off: np.ndarray = np.abs(elevation - pattern.elevations_deg)
    return off


def _nearest_cone(places: np.ndarray, pattern: ScanPattern) -> np.ndarray:
    nearest: np.ndarray = _cone_distances(places, pattern).argmin(-1)
    return nearest


def _off_nearest_cone(places: np.ndarray, pattern: ScanPattern) -> np.ndarray:
    off: np.ndarray = _cone_distances(places, pattern).min(-1)
    return off


def test_pairs_of_a_dual_return_file_share_their_fate() -> None:
    path = recording("wads_snow/velodyne/042223.bin")
    values = np.fromfile(path, np.float32).reshape(-1, 4)
    labels = np.fromfile(recording("wads_snow/labels/042223.label"), np.uint32) & 0xFFFF
    cloud = torch.from_numpy(values[labels != 110])
    sensor = replace(Lidar.preset("pandar64-wads"), return_mode="strongest")
    first = first_rows(cloud[:, :3].double().numpy(), recover_ring(cloud, sensor).numpy(), 0.2)
    second = np.flatnonzero(first != np.arange(len(first)))
    identical = second[(values[labels != 110][second] == values[labels != 110][first[second]]).all(1)]
    assert len(identical) > 10_000
    snow = LidarSnow(Snow(rate_mm_per_h=1.0), sensor)
    result = snow.run(cloud, snow.draw(cloud, seed=2))
    assert isinstance(result.kind, Tensor)
    assert isinstance(result.points, Tensor)
    assert torch.equal(result.kind[identical], result.kind[first[identical]])
    assert torch.equal(result.points[identical], result.points[first[identical]])
