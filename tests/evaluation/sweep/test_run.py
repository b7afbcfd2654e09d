"""The tidy table: one row a score, the scores those of the transform's own output."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Weather, parse_weather
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.sweep import (
    COLUMNS,
    CameraSubject,
    LidarSubject,
    RadarSceneSubject,
    RadarSubject,
    parse_levels,
    samples,
    sweep,
)
from torchweather.metrics import Region, bayer_scores, cloud_scores, image_scores
from torchweather.radar import FmcwRadar
from torchweather.scenes import radar_view, test_track
from torchweather.scenes.raw_frame import raw_frame
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import AsBayer, BayerWeather, LidarWeather, RadarAttenuation

CAMERA = Camera.preset("lucid-triton").resized(32, 24)
LIDAR = Lidar.preset("velodyne-hdl-64e")


def frame(channels: int = 1) -> Tensor:
    return torch.rand(channels, 24, 32, generator=torch.Generator().manual_seed(1)) * 0.6 + 0.1


def depth() -> Tensor:
    return torch.linspace(5.0, 120.0, 32).expand(1, 24, 32).contiguous()


def cloud(rows: int = 300) -> Tensor:
    random = torch.Generator().manual_seed(3)
    way = torch.randn(rows, 3, generator=random) * torch.tensor([1.0, 1.0, 0.1])
    xyz = way / way.norm(dim=-1, keepdim=True) * (3 + 57 * torch.rand(rows, 1, generator=random))
    return torch.cat([xyz, torch.randint(1, 60, (rows, 1), generator=random).float()], -1)


def camera_subject(**options: Any) -> CameraSubject:
    return CameraSubject("a", frame(), depth(), CAMERA, options={"airlight": 0.8}, **options)


@dataclass
class Counting:
    """A subject that counts what is asked of it; its data are the seed where ``random``."""

    random: bool
    name: str = "counting"
    scene: str = "counting"
    indoors: bool = False
    scored: list[float] = field(default_factory=list)

    sensor: ClassVar[str] = "lidar"
    directions: ClassVar[dict[str, str]] = {"mde": "down"}

    def render(self, weather: Weather, seed: int) -> Tensor:
        return torch.tensor([float(seed) if self.random else 1.0])

    def score(self, distorted: Tensor, names: Any) -> dict[str, float]:
        self.scored.append(float(distorted))
        return dict.fromkeys(names, float(distorted))

    def facts(self, distorted: Tensor | None) -> dict[str, float]:
        return {}


def test_the_table_has_one_row_a_score_in_the_named_columns() -> None:
    told: list[int] = []
    table = sweep([camera_subject()], parse_levels("rain:rate=50,5"), [4, 9], ["psnr", "gmsd"], progress=told.append)
    assert tuple(table) == COLUMNS
    assert [len(column) for column in table.values()] == [8] * 9
    assert told == [1] * 4
    rows = list(zip(*table.values(), strict=True))
    assert [row[:8] for row in rows[:3]] == [
        ("a", "camera", "rain", "rate_mm_per_h", 5.0, 1, 4, "psnr"),
        ("a", "camera", "rain", "rate_mm_per_h", 5.0, 1, 4, "gmsd"),
        ("a", "camera", "rain", "rate_mm_per_h", 5.0, 1, 9, "psnr"),
    ]
    assert table["severity"] == [1] * 4 + [2] * 4


def test_raw_frames_are_scored_after_demosaic_as_srgb() -> None:
    table = sweep([camera_subject()], parse_levels("rain:rate=10,50"), [7], ["psnr", "gmsd"])
    transform = BayerWeather(parse_weather("rain:rate=50"), CAMERA, airlight=0.8)
    rainy = transform(frame(), depth(), transform.draw(frame(), seed=7))
    wanted = bayer_scores(rainy, frame(), ["psnr", "gmsd"], pattern=CAMERA.bayer_pattern)
    assert table["score"][2:] == [float(wanted["psnr"]), float(wanted["gmsd"])]


def test_integer_frames_are_scored_in_linear_light_above_black() -> None:
    camera = Camera.from_dict({**CAMERA.to_dict(), "bit_depth": 12, "black_level": 200.0, "white_level": 3000.0})
    raw = (200.0 + 2800.0 * frame()).round().to(torch.uint16)
    subject = CameraSubject("a", raw, depth(), camera, options={"airlight": 0.8})
    in_fog = subject.render(parse_weather("fog:mor=100"), 0)
    wanted = bayer_scores(
        (in_fog.int() - 200).float() / 2800.0, (raw.int() - 200).float() / 2800.0, ["psnr"], pattern="RGGB"
    )
    assert subject.score(in_fog, ["psnr"])["psnr"] == pytest.approx(float(wanted["psnr"]), rel=1e-5)


def test_rgb_frames_are_scored_as_they_are() -> None:
    rgb = (255 * frame(3)).round().to(torch.uint8)
    subject = CameraSubject("a", rgb, depth(), CAMERA, options={"airlight": 0.8})
    table = sweep([subject], parse_levels("fog:mor=400,50"), [0], ["psnr"])
    transform = AsBayer(BayerWeather(parse_weather("fog:mor=50"), CAMERA, airlight=0.8))
    foggy = transform(rgb, depth(), transform.draw(rgb, seed=0))
    assert table["score"][1] == pytest.approx(float(image_scores(foggy / 255.0, rgb / 255.0, ["psnr"])["psnr"]))


def test_clouds_are_scored_against_the_clear_cloud_inside_the_region() -> None:
    region = Region(x_m=(0.0, 28.0))
    subject = LidarSubject("c", points=cloud(), lidar=LIDAR, region=region)
    table = sweep([subject], parse_levels("snow:rate=1,5"), [2])
    transform = LidarWeather(parse_weather("snow:rate=5"), LIDAR)
    snowy = transform(cloud(), transform.draw(cloud(), seed=2))
    wanted = cloud_scores(snowy, cloud(), region=region)
    assert table["metric"][:6] == list(wanted)
    assert table["score"][6:] == [float(score) for score in wanted.values()]
    assert wanted["mde"] != cloud_scores(snowy, cloud())["mde"]


def test_detections_fade_in_heavy_rain() -> None:
    radar = Radar.preset("imaging-77ghz", noise_floor_db=0.0)
    weak = radar.detection_snr_db + torch.arange(20) * 0.3
    points = torch.stack([torch.linspace(20, 90, 20), *torch.zeros(3, 20), weak, torch.zeros(20)], -1)
    subject = RadarSubject("r", points=points, radar=radar)
    table = sweep([subject], parse_levels("rain:rate=5,50"), [0], ["mde"])
    transform = RadarAttenuation(parse_weather("rain:rate=50"), radar)
    left = transform(points, transform.draw(points, seed=0))
    assert 0 < int((left[:, 0] > 0).sum()) < 20
    assert table["score"][1] == float(cloud_scores(left, points, names=["mde"])["mde"])
    assert table["score"][0] < table["score"][1]


def test_a_simulated_radar_frame_keeps_the_receiver_s_noise() -> None:
    radar = Radar.preset("awr1843-like")
    scatterers = radar_view(test_track(), radar).scatterers
    subject = RadarSceneSubject("scene", scatterers=scatterers, radar=radar, noise_seed=5)
    plain = FmcwRadar(radar)
    assert torch.equal(subject.clear, plain(scatterers, plain.draw(scatterers, seed=5)))
    # Fog at a kilometre takes next to nothing and draws nothing: the clear frame again.
    assert subject.score(subject.render(parse_weather("fog:mor=1000"), 3), ["mde"])["mde"] < 1e-3
    # Rain's echoes are drawn with the seed.
    heavy = parse_weather("rain:rate=50")
    assert not torch.equal(subject.render(heavy, 1), subject.render(heavy, 2))


def test_the_storm_of_a_seed_stays_while_its_rate_rises() -> None:
    """A beam that loses its object in light snow loses it in heavy snow of the same seed, too."""
    subject = LidarSubject("c", points=cloud(2000), lidar=LIDAR)
    kept = [subject.run(level.weather, 11).kind == 0 for level in parse_levels("snow:rate=0.5,1,2,5")]
    for light, heavy in pairwise(kept):
        assert bool((~light).any())
        assert not bool((heavy & ~light).any())


def test_equal_data_are_scored_once() -> None:
    same, other = Counting(random=False), Counting(random=True)
    found = list(samples([same], parse_levels("rain:rate=1,2"), [1, 2, 3]))
    assert len(found) == 6
    assert len(same.scored) == 2
    assert [sample.score_s > 0 for sample in found] == [True, False, False] * 2
    list(samples([other], parse_levels("rain:rate=1,2"), [1, 2, 3]))
    assert len(other.scored) == 6


def test_indoors_it_neither_rains_nor_snows() -> None:
    levels = parse_levels("rain:rate=1,5") + parse_levels("fog:mor=100,50")
    table = sweep([camera_subject(indoors=True)], levels, [0], ["psnr"])
    assert set(table["weather"]) == {"fog"}
    with pytest.raises(ValueError, match="Indoors give fog"):
        sweep([camera_subject(indoors=True)], parse_levels("rain:rate=1,5+fog:mor=100"), [0], ["psnr"])


def test_what_cannot_be_swept_is_refused() -> None:
    rain = parse_levels("rain:rate=1,5")
    with pytest.raises(ValueError, match="seeds that differ"):
        sweep([camera_subject()], rain, [1, 1])
    with pytest.raises(ValueError, match="seeds that differ"):
        sweep([camera_subject()], rain, [])
    with pytest.raises(ValueError, match="each weather once"):
        sweep([camera_subject()], rain + rain, [1])
    with pytest.raises(ValueError, match="different names; got a"):
        sweep([camera_subject(), camera_subject()], rain, [1])
    with pytest.raises(ValueError, match="metric"):
        sweep([camera_subject()], rain, [1], ["mde"])
    with pytest.raises(TorchweatherError, match=r"a: .*161"):  # the frame is too small for MS-SSIM
        sweep([camera_subject()], rain, [1], ["ms_ssim"])


def test_raw_frame_of_a_scene_has_the_camera_s_levels() -> None:
    camera = Camera.from_dict({**CAMERA.to_dict(), "response_knots": None})
    found = raw_frame(test_track(), camera, seed=3)
    assert found.bayer.dtype == torch.uint16
    assert int(found.bayer.int().max()) <= camera.saturation_level
    assert bool(torch.isinf(found.depth_m).any())
    assert torch.equal(found.bayer, raw_frame(test_track(), camera, seed=3).bayer)
    assert not torch.equal(found.bayer, raw_frame(test_track(), camera, seed=4).bayer)
