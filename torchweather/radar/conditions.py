"""Water and snow on things before a radar: effects of the catalogue, with values from the conditions' laws."""

from __future__ import annotations

from torchweather.atmosphere.conditions import RoadSpray, WetWindow, condition_of
from torchweather.atmosphere.conditions.road_spray import spray_values
from torchweather.atmosphere.conditions.wet_window import film_on_window_mm
from torchweather.atmosphere.weather import Weather
from torchweather.physics.window_film import microwave_film_loss_db
from torchweather.pipeline.conditions import OfConditions
from torchweather.pipeline.effect import Effect
from torchweather.radar.effects.path import RadarWetRadome
from torchweather.radar.effects.spray import RadarRoadSpray
from torchweather.radar.sensor import Radar

__all__ = ["radar_conditions"]

COVER_M = 0.06  # height of the cover of a radar, which stands upright


def radar_conditions(weather: Weather, sensor: Radar) -> OfConditions:
    """Effects of a radar for the conditions of a weather; water and snow on the road are none.

    Args:
        weather: with numbers; a condition of amount 0 makes no effect.
        sensor: whose carrier decides what a film costs.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> weather = Mixture(Rain(25), WetWindow(speed_m_per_s=20))
        >>> ((_, effect),) = radar_conditions(weather, Radar()).effects
        >>> effect.id, round(float(effect.loss_db), 1)
        ('radar.wet_radome', 9.1)
    """
    effects: list[tuple[Weather, Effect]] = []
    window = condition_of(weather, WetWindow)
    if window is not None and not window.is_nothing:
        film = film_on_window_mm(window, weather, length_m=COVER_M, inclination_deg=90.0)
        loss_db = 2.0 * microwave_film_loss_db(film, sensor.frequency_ghz)
        effects.append((window, RadarWetRadome(loss_db=loss_db[0] if loss_db.numel() == 1 else loss_db)))
    spray = condition_of(weather, RoadSpray)
    if spray is not None and not spray.is_nothing:
        effects.append((spray, RadarRoadSpray(**spray_values(spray, weather))))
    return OfConditions(tuple(effects))
