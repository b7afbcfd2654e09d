"""Every stage of the catalogue declares the fields of the state that it reads and writes: no more and no less."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from tests.atmosphere import condition_scene
from tests.behaviour.cases import cases
from tests.camera.effects import camera_effect_scene
from tests.contract.table import CAMERA, LIDAR, TABLE, H, W, cloud, frame, map_weather, rays
from tests.contract.traced import Trace, traced
from tests.lidar.effects import effect_scene
from tests.radar.effects import radar_effect_scene
from torchweather.atmosphere.conditions import RoadSpray, SnowCover, WetRoad, WetWindow
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.camera.depth import SceneDepth
from torchweather.lidar.effects.empirical import AXES, KINDS, Empirical
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.registry import STAGES, load_catalogue
from torchweather.radar.map_transform import MAP_EFFECTS
from torchweather.stages import EFFECTS, Quantise
from torchweather.transforms import BayerWeather, LidarWeather, RadarAttenuation

load_catalogue()
OURS = {name: stage for name, stage in STAGES.items() if stage.__module__.startswith("torchweather.")}

PATCHY = Mixture(Rain(30.0, patch_log_std=0.5, patch_length_m=30.0), Fog(40.0, patch_log_std=0.5, patch_length_m=30.0))


def ran(transform: Any, data: Tensor, **more: Any) -> None:
    transform(data, noise=transform.draw(data, seed=3), **more)


def cameras() -> None:
    """Parts of the sky and the own vehicle in the scene, a layer of fog, a grey sky, the sky's own light."""
    depth_m = torch.full((1, H, W), 30.0)
    depth_m[:, : H // 2] = math.inf
    share = torch.linspace(0.0, 1.0, W).expand(1, H, W)
    scene = SceneDepth(depth_m, sky=share, near_mask=share.flip(-1))
    for variant in (None, "d3_4"):
        for airlight in ("sky", "grey", (0.5, 0.6, 0.7)):
            chain = BayerWeather(PATCHY, CAMERA, airlight=airlight, sky="overcast", variant=variant)
            for known in (scene, depth_m):
                ran(chain, frame(2), depth=known)
    brighter = {"effect": "camera.extinction_scale", "factor": 1.5}
    dark = (frame(2).float() / 8).to(frame(2).dtype)
    ran(BayerWeather(PATCHY, CAMERA, night=True, airlight="sky", effects=[brighter]), dark, depth=scene)
    transform = BayerWeather(Mixture(Rain(30.0), Fog(80.0)), CAMERA, airlight=(0.5, 0.6, 0.7))
    state = transform.state_of(frame(2), depth_m)
    Quantise(255)(state, {})
    ran(BayerWeather(Fog(80.0), CAMERA, exposure_control="mean"), frame(2), depth=depth_m)
    ran_with_truth = transform.run(frame(2), depth_m, transform.draw(frame(2), seed=3))
    assert ran_with_truth.particle_mask is not None


def banks() -> None:
    """Rain and snow of training quality before a sky in part of the pixels, with and without their own vehicle."""
    depth_m = torch.full((1, H, W), 30.0)
    depth_m[:, : H // 2] = math.inf
    share = torch.linspace(0.0, 1.0, W).expand(1, H, W)
    camera = replace(CAMERA, pitch_rad=0.0)
    for scene in (SceneDepth(depth_m, sky=share, near_mask=share.flip(-1)), depth_m):
        chain = BayerWeather(Mixture(Rain(30.0), Snow(1.0)), camera, airlight="sky", quality="training")
        ran(chain, frame(2), depth=scene)
        assert chain.run(frame(2), scene, chain.draw(frame(2), seed=3)).particle_mask.any()


def lidars() -> None:
    """Fog, rain and snow with gusts, and every curve that measurements add."""
    for unit in (LIDAR.intensity_unit, "none"):
        ran(LidarWeather(PATCHY, replace(LIDAR, intensity_unit=unit)), cloud(2), directions=rays(2))
    doppler = torch.cat([cloud(2), torch.zeros_like(cloud(2)[..., :1])], -1)
    sensor = replace(LIDAR, speed_column=doppler.shape[-1] - 1, return_mode="dual")
    ran(LidarWeather(PATCHY, sensor, ego_speed_m_per_s=5.0), doppler, directions=rays(2))
    transform = effect_scene.rain()
    state = effect_scene.begin(transform)
    state = state.changed(cos_incidence=torch.full_like(state.scene.clear_range_m, 0.5), up=state.scene.clear_range_m)
    for kind, axis in itertools.product(KINDS, AXES):
        of = "particle" if axis.startswith("particle") else "object"
        if of in KINDS[kind]:
            places = {"places_m": [1.0, 9.0], "shares": [1.0]} if kind == "returns" else {}
            nodes = {"at": [0.0], "value": [0.5], "measured_from": -1.0, "measured_to": 1.0}
            stage = Empirical(kind, axis, of=of, **nodes, **places)
            stage(state, stage.draw(state, seed=1))


def radars() -> None:
    """Gusts, echoes of the rain, and all effects at once, each of which another one can change."""
    gusty = Mixture(Rain(30.0, patch_log_std=0.5), Snow(3.0, patch_log_std=0.5))
    effects = [radar_effect_scene.active(name) for name in EFFECTS if name.startswith("radar.")]
    points = radar_effect_scene.detections()
    for more in ({"clutter": True, "radome_film_db": 0.5}, {"effects": effects}):
        ran(RadarAttenuation(gusty, radar_effect_scene.SENSOR, **more), points, **radar_effect_scene.known())
    maps = map_weather(gusty, effects=[radar_effect_scene.active(name) for name in MAP_EFFECTS])
    ran(maps, TABLE["RadarMapWeather"].data(2))


def conditions() -> None:
    """Water on the road and the windows, normals from the depth and from the call."""
    wet = Mixture(
        Rain(20.0),
        WetRoad(puddles=0.5),
        WetWindow(speed_m_per_s=10.0),
        SnowCover(depth_mm=5.0),
        RoadSpray(speed_m_per_s=20.0),
    )
    image = condition_scene.frame((2,))
    transform = condition_scene.camera_in(wet)
    ran(transform, image)
    ran(transform, image, normal=torch.zeros(3, *image.shape[-2:]))
    image[..., : image.shape[-2] // 2, :] = 0.7
    depth_m = torch.full(image.shape[1:], 30.0)
    depth_m[:, : image.shape[-2] // 2] = math.inf
    for scene in (depth_m, SceneDepth(depth_m, sky=depth_m.isinf().float())):
        ran(BayerWeather(wet, condition_scene.CAMERA), image, depth=scene)
        spray = camera_effect_scene.active("camera.road_spray")
        shown = replace(scene, near_mask=depth_m * 0.0) if isinstance(scene, SceneDepth) else scene
        for weather in (Rain(5.0), Fog(60.0)):
            ran(BayerWeather(weather, condition_scene.CAMERA, effects=[spray]), image, depth=shown)
    points = condition_scene.cloud()
    ran(LidarWeather(wet, condition_scene.LIDAR), points)
    rings = replace(condition_scene.LIDAR, elevations_deg=tuple(range(-8, 8)), columns=len(points) // 16)
    ran(LidarWeather(wet, rings), points)
    ran(LidarWeather(WetRoad(water_mm=1.0), condition_scene.LIDAR), points)


@pytest.fixture(scope="module")
def trace() -> Trace:
    """All stages of the catalogue at work."""
    with traced() as trace:
        for name, case in cases().items():
            if name.startswith("effects/"):
                case()
        for entry in TABLE.values():
            ran(entry.built(), entry.data(2), **entry.beside(2))
        for more in (cameras, banks, lidars, radars, conditions):
            more()
    return trace


@pytest.mark.parametrize("name", sorted(OURS))
def test_a_stage_reads_and_writes_what_it_declares(name: str, trace: Trace) -> None:
    stage = OURS[name]
    assert trace.runs[stage], f"{name}: no case runs it"
    assert sorted(stage.reads) == sorted(trace.reads[stage])
    assert sorted(stage.writes) == sorted(trace.writes[stage])


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_needs_what_it_reads(name: str) -> None:
    fields = {field.partition(".")[2] for field in EFFECTS[name].reads}
    assert set(EFFECTS[name].needs) <= fields


class Undeclared(Effect):
    """Darkens the frame, and declares that it changes its airlight."""

    id: ClassVar[str] = "camera.undeclared"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 1.0, scale=0.1, identity=0.0),)
    writes: ClassVar[tuple[str, ...]] = ("air.airlight",)

    def changes(self, state: Any, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {"signal": state.image.signal * (1 - self.share)}


def test_an_effect_that_writes_another_field_is_refused() -> None:
    state = BayerWeather(Rain(1.0), CAMERA).state_of(frame(1), torch.ones(1, H, W))
    with pytest.raises(TypeError, match=r"Undeclared: it declares writes = \('air.airlight',\); got .*image.signal"):
        Undeclared(share=0.5)(state, {})
