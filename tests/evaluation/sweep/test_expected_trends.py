"""The scores of the embedded test track get worse as the weather does: METRICS.md 3, held on the mean of three seeds.

The levels are those that a user would take, five a weather; the frame and the scan are reduced so that the file runs in
under a minute on one core: 256 x 194 pixels of the lucid-triton (MS-SSIM takes 161 a side) and 128 of the 1024 columns
of the ouster-os1-128. At five levels a score in random order would follow with a probability of 1 in 120.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from torchweather.evaluation.sweep import CameraSubject, LidarSubject, judged, parse_levels, samples, series_of
from torchweather.evaluation.sweep.series import Series
from torchweather.metrics import CLOUD_SCORES, IMAGE_SCORES
from torchweather.scenes import lidar_view, test_track
from torchweather.scenes.raw_frame import raw_frame
from torchweather.sensors import Camera, Lidar

pytestmark = pytest.mark.slow

SEEDS = (0, 1, 2)
RAIN, FOG, SNOW = "rain:rate=1,5,10,25,50", "fog:mor=400,200,100,50,30", "snow:rate=0.5,1,2,3,5"


@pytest.fixture(scope="module")
def camera() -> CameraSubject:
    frame = raw_frame(test_track(), Camera.preset("lucid-triton").resized(256, 194))
    return CameraSubject("test-track", frame.bayer, frame.depth_m, frame.camera)


@pytest.fixture(scope="module")
def lidar() -> LidarSubject:
    sensor = replace(Lidar.preset("ouster-os1-128"), columns=128)
    view = lidar_view(test_track(), sensor, range_noise_seed=0)
    return LidarSubject("test-track", points=view.points, lidar=sensor, beams=view.directions)


@cache  # tests of one sweep share it
def swept(subject: CameraSubject | LidarSubject, weather: str) -> Series:
    (series,) = series_of(samples([subject], parse_levels(weather), SEEDS))
    assert len(series.levels) == 5
    return series


def missing(series: Series) -> set[str]:
    trends = judged(series)
    assert trends.out_of == len(CLOUD_SCORES if series.sensor == "lidar" else IMAGE_SCORES)
    found = {name for name, one in trends.metrics.items() if not one.follows}
    assert trends.expected == trends.out_of - len(found)
    return found


# Fog wants all; rain and snow may miss one. On the scene as it is, none misses one.
@pytest.mark.parametrize(("weather", "may_miss"), [(FOG, 0), (RAIN, 1), (SNOW, 1)])
def test_image_scores_follow_the_weather(camera: CameraSubject, weather: str, may_miss: int) -> None:
    found = missing(swept(camera, weather))
    assert len(found) <= may_miss, found


# Rain: fewer than 5 % of the points change, so HD95 is 0 throughout. Snow: SDM turns, see below.
@pytest.mark.parametrize(("weather", "may_miss"), [(FOG, 0), (RAIN, 1), (SNOW, 1)])
def test_cloud_scores_follow_the_weather(lidar: LidarSubject, weather: str, may_miss: int) -> None:
    found = missing(swept(lidar, weather))
    assert len(found) <= may_miss, found


def test_vif_follows_fog_only_with_its_arguments_in_order(camera: CameraSubject) -> None:
    in_fog = [camera.render(level.weather, 0) for level in parse_levels(FOG)]
    right = [camera.score(frame, ["vif"])["vif"] for frame in in_fog]
    swapped = [replace(camera, data=frame).score(camera.data, ["vif"])["vif"] for frame in in_fog]
    assert sorted(right, reverse=True) == right
    # As D3.4's: thick fog scores better than thin.
    assert swapped[-1] > swapped[0]


def test_sdm_turns_in_snow_because_the_cloud_moves_out_again(lidar: LidarSubject) -> None:
    """The returns of light snow are near and draw the cloud together. The flakes of heavy snow are larger and seen from
    farther out: the distances between points grow back towards those of clear air."""
    # Flakes as bright as a pack of snow: with thin ones the turn comes beyond 5 mm/h.
    series = swept(lidar, f"{SNOW},flake_reflectivity=0.9")
    sdm, distance_m = series.scores["sdm"].mean(1), series.facts["pair_distance_m"].mean(1)
    # From 2 to 5 mm/h, against the scatter of the seeds.
    error = (sdm[4] - sdm[2]) / (series.scores["sdm"][4] - series.scores["sdm"][2]).std(ddof=1) * len(SEEDS) ** 0.5
    assert error < -2.92  # Student's t of three seeds, one-sided 95 %
    assert distance_m[2] < distance_m[4] < series.clear["pair_distance_m"]
    assert (series.facts["range_m"].mean(1)[1:] > series.facts["range_m"].mean(1)[:-1]).all()
    assert (series.scores["mde"].mean(1)[1:] > series.scores["mde"].mean(1)[:-1]).all()
