"""Radar as it is recorded: maps of power over range and azimuth, their scale and noise, weather in them, CFAR."""

from torchweather.radar.power_map.cells import PowerMapState, map_state
from torchweather.radar.power_map.clutter import MapClutter, map_noise_floor_dbm
from torchweather.radar.power_map.map_detections import map_cfar, map_detections
from torchweather.radar.power_map.noise_floor import noise_correlation, noise_floor_db, quiet_cells, with_noise_scale
from torchweather.radar.power_map.power_map import MAP_DIMENSIONS, MapAxes, RadarPowerMap
from torchweather.radar.power_map.receiver import MapReceiver, oversampled_taps
from torchweather.radar.power_map.scale import SCALE_KINDS, PowerScale

__all__ = [
    "MAP_DIMENSIONS",
    "SCALE_KINDS",
    "MapAxes",
    "MapClutter",
    "MapReceiver",
    "PowerMapState",
    "PowerScale",
    "RadarPowerMap",
    "map_cfar",
    "map_detections",
    "map_noise_floor_dbm",
    "map_state",
    "noise_correlation",
    "noise_floor_db",
    "oversampled_taps",
    "quiet_cells",
    "with_noise_scale",
]
