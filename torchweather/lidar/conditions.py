"""Water and snow on things before a LiDAR: effects of the catalogue, with values from the conditions' laws."""

from __future__ import annotations

import math

import torch

from torchweather.atmosphere.conditions import RoadSpray, SnowCover, WetRoad, WetWindow, condition_of
from torchweather.atmosphere.conditions.road_spray import spray_values
from torchweather.atmosphere.conditions.wet_road import water_on_road_mm
from torchweather.atmosphere.conditions.wet_window import drops_on_window, film_on_window_mm
from torchweather.atmosphere.weather import Weather
from torchweather.lidar.effects.air import LidarWetTarget, LidarWindowLoss
from torchweather.lidar.effects.road_spray import LidarRoadSpray
from torchweather.lidar.effects.surfaces import LidarSnowCover
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.surfaces import LidarRoadWater, LidarSurfaceNormals
from torchweather.physics.refractive_index import water_refractive_index
from torchweather.physics.road_water import wet_albedo
from torchweather.physics.snow_pack import snow_pack_albedo
from torchweather.physics.window_film import optical_film_transmittance
from torchweather.pipeline.conditions import OfConditions
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.stage import Stage

__all__ = ["lidar_conditions"]

WINDOW_M = 0.05  # height of the window of a LiDAR, which stands upright
# Way in and out through water at grazing incidence, over its depth: 2 / cos(asin(1 / n)).
WAYS_IN_WATER = 2.0 / math.sqrt(1.0 - 1.0 / 1.33**2)


def lidar_conditions(weather: Weather, sensor: Lidar) -> OfConditions:
    """Effects of a LiDAR, and the stages that these need, for the conditions of a weather.

    Args:
        weather: with numbers; a condition of amount 0 makes no effect.
        sensor: whose wavelength decides what water absorbs.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> weather = Mixture(Rain(10), WetRoad(), WetWindow(speed_m_per_s=20))
        >>> [effect.id for _, effect in lidar_conditions(weather, Lidar(wavelength_nm=905.0)).effects]
        ['lidar.wet_target', 'lidar.window_loss']
    """
    effects: list[tuple[Weather, Effect]] = []
    surfaces: dict[str, Stage] = {}
    road, window = condition_of(weather, WetRoad), condition_of(weather, WetWindow)
    snow = condition_of(weather, SnowCover)
    if snow is not None and not snow.is_nothing:
        surfaces["surface_normals"] = LidarSurfaceNormals()
        grain = float(snow.grain_um)  # type: ignore[arg-type]
        values = {
            "depth_mm": float(snow.depth_mm),  # type: ignore[arg-type]
            "reflectivity": float(snow_pack_albedo(sensor.wavelength_nm, grain)),
            "uneven": float(snow.uneven),  # type: ignore[arg-type]
        }
        effects.append((snow, LidarSnowCover(**values)))
    if road is not None and not road.is_nothing:
        water = water_on_road_mm(road, weather)
        texture, albedo = float(road.texture_mm), float(road.albedo)  # type: ignore[arg-type]
        surfaces["road_water"] = LidarRoadWater(water, texture, float(road.puddles))  # type: ignore[arg-type]
        kappa = float(water_refractive_index(sensor.wavelength_nm).imag)
        absorbed = torch.exp(-4e6 * math.pi * kappa / sensor.wavelength_nm * WAYS_IN_WATER * water)
        share = 1.0 - float(wet_albedo(albedo)) / albedo * absorbed
        effects.append((road, LidarWetTarget(share=share[0] if share.numel() == 1 else share)))
    if window is not None and not window.is_nothing:
        film = film_on_window_mm(window, weather, length_m=WINDOW_M, inclination_deg=90.0)
        through = optical_film_transmittance(film, sensor.wavelength_nm)
        through = through * (1.0 - drops_on_window(window, weather, inclination_deg=90.0, wiped=False))
        # A film may mirror less than the dry window, and a window that gains counts as one that loses nothing.
        loss_db = (-20.0 * torch.log10(through)).clamp_min(0.0)
        effects.append((window, LidarWindowLoss(loss_db=loss_db[0] if loss_db.numel() == 1 else loss_db)))
    spray = condition_of(weather, RoadSpray)
    if spray is not None and not spray.is_nothing:
        effects.append((spray, LidarRoadSpray(**spray_values(spray, weather))))
    return OfConditions(tuple(effects), surfaces)
