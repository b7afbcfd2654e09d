"""FMCW radar: scatterers to beat signal to range-Doppler-angle map to points, with weather at its physical places."""

from torchweather.radar.fmcw.angles import angle_grid, range_doppler_angle
from torchweather.radar.fmcw.beat_signal import beat_signal
from torchweather.radar.fmcw.bodies import corner_reflector_rcs_m2, corner_scatterers, facet_scatterers, gathered
from torchweather.radar.fmcw.car import car_details, car_facets, car_scatterers
from torchweather.radar.fmcw.cfar import CellAveragingCfar, OrderStatisticCfar
from torchweather.radar.fmcw.facet_rcs import isosceles_triangle_rcs_m2, subdivide, triangle_field_m
from torchweather.radar.fmcw.fmcw import FmcwRadar, FmcwResult, cfar_for
from torchweather.radar.fmcw.range_doppler import map_noise_dbm, range_doppler
from torchweather.radar.fmcw.range_doppler_map import RangeDopplerMap
from torchweather.radar.fmcw.scatterers import Scatterers
from torchweather.radar.fmcw.volume_echo import VolumeEcho
from torchweather.radar.fmcw.windows import WINDOWS

__all__ = [
    "WINDOWS",
    "CellAveragingCfar",
    "FmcwRadar",
    "FmcwResult",
    "OrderStatisticCfar",
    "RangeDopplerMap",
    "Scatterers",
    "VolumeEcho",
    "angle_grid",
    "beat_signal",
    "car_details",
    "car_facets",
    "car_scatterers",
    "cfar_for",
    "corner_reflector_rcs_m2",
    "corner_scatterers",
    "facet_scatterers",
    "gathered",
    "isosceles_triangle_rcs_m2",
    "map_noise_dbm",
    "range_doppler",
    "range_doppler_angle",
    "subdivide",
    "triangle_field_m",
]
