"""Water and snow on things before a camera: effects of the catalogue, with values from the conditions' laws."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from torchweather.atmosphere.conditions import RoadSpray, SnowCover, WetRoad, WetWindow, condition_of
from torchweather.atmosphere.conditions.road_spray import spray_values
from torchweather.atmosphere.conditions.wet_road import water_on_road_mm
from torchweather.atmosphere.conditions.wet_window import drops_on_window
from torchweather.atmosphere.weather import Weather
from torchweather.camera.effects.air import CameraWetSurface
from torchweather.camera.effects.refraction import CameraRefractingDrops
from torchweather.camera.effects.spray import CameraRoadSpray
from torchweather.camera.effects.surfaces import CameraSnowCover
from torchweather.camera.sensor import Camera
from torchweather.camera.surfaces import CameraRoadWater, CameraSkyLight, CameraSurfaceNormals
from torchweather.physics.road_water import wet_albedo
from torchweather.physics.snow_pack import snow_pack_albedo
from torchweather.pipeline.conditions import OfConditions
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.stage import Stage

__all__ = ["camera_conditions"]

GREEN_NM = 550.0
PUPIL_M = 2e-3  # entrance pupil of a camera whose f-number is not known
WINDOW_M = 0.06  # from the lens to the window along the axis; order of magnitude
WINDSCREEN_DEG = 30.0  # of a car's windscreen from the level


def camera_conditions(weather: Weather, camera: Camera, airlight: Any = None) -> OfConditions:
    """Effects of a camera, and the stages that these need, for the conditions of a weather.

    Args:
        weather: with numbers; a condition of amount 0 makes no effect.
        camera: whose aperture decides how sharp drops on the window are.
        airlight: signals of the sky, or how to estimate them, as `BayerWeather`.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> weather, camera = Mixture(Rain(10), WetRoad(), WetWindow()), Camera.preset("lucid-triton")
        >>> [effect.id for _, effect in camera_conditions(weather, camera).effects]
        ['camera.wet_surface', 'camera.refracting_drops']
    """
    effects: list[tuple[Weather, Effect]] = []
    surfaces: dict[str, Stage] = {}
    road, window = condition_of(weather, WetRoad), condition_of(weather, WetWindow)
    if road is not None and not road.is_nothing:
        surfaces["surface_normals"] = CameraSurfaceNormals()
        water = water_on_road_mm(road, weather)
        surfaces["road_water"] = CameraRoadWater(water, number(road.texture_mm), number(road.puddles))
        darkening = 1.0 - float(wet_albedo(number(road.albedo))) / number(road.albedo)
        effects.append((road, CameraWetSurface(darkening=darkening, mirror=1.0)))
    snow = condition_of(weather, SnowCover)
    if snow is not None and not snow.is_nothing:
        surfaces["surface_normals"] = CameraSurfaceNormals()
        surfaces["sky_light"] = CameraSkyLight(airlight)
        albedo = float(snow_pack_albedo(GREEN_NM, number(snow.grain_um)))
        values = {"depth_mm": number(snow.depth_mm), "albedo": albedo, "uneven": number(snow.uneven)}
        effects.append((snow, CameraSnowCover(**values)))
    if window is not None and not window.is_nothing:
        cover = drops_on_window(window, weather, inclination_deg=WINDSCREEN_DEG)
        blur_px = min(400.0, (camera.aperture_m or PUPIL_M) / WINDOW_M * camera.fx)
        effects.append((window, CameraRefractingDrops(cover=one_or_each(cover), blur_px=blur_px)))
    spray = condition_of(weather, RoadSpray)
    if spray is not None and not spray.is_nothing:
        surfaces["sky_light"] = CameraSkyLight(airlight)
        effects.append((spray, CameraRoadSpray(**spray_values(spray, weather))))
    return OfConditions(tuple(effects), surfaces)


def number(value: object) -> float:
    """A field of a condition that has been drawn."""
    return float(value)  # type: ignore[arg-type]


def one_or_each(values: Tensor) -> Tensor:
    """Values ``(1,)`` as one number, ``(B,)`` as they are."""
    return values[0] if values.numel() == 1 else values
