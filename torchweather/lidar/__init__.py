"""Sensor and scene from a LiDAR's sweep: scan pattern, ground, ends of beams without return."""

from __future__ import annotations

from torchweather.lidar.static_speed import static_speed_m_per_s
from torchweather.lidar.sweep.beam_ends import BeamEnd, BeamEnds, beam_ends
from torchweather.lidar.sweep.ground import GroundPlane, fit_ground
from torchweather.lidar.sweep.near_response import NearResponseFit, fit_near_response
from torchweather.lidar.sweep.own_vehicle import OwnVehicleMask, own_vehicle_mask
from torchweather.lidar.sweep.pattern_fit import PatternFit, fit_pattern
from torchweather.lidar.sweep.scan_counts import check_scan_counts, scan_count_problem
from torchweather.lidar.sweep.scan_pattern import ScanPattern, estimate_pattern

__all__ = [
    "BeamEnd",
    "BeamEnds",
    "GroundPlane",
    "NearResponseFit",
    "OwnVehicleMask",
    "PatternFit",
    "ScanPattern",
    "beam_ends",
    "check_scan_counts",
    "estimate_pattern",
    "fit_ground",
    "fit_near_response",
    "fit_pattern",
    "own_vehicle_mask",
    "scan_count_problem",
    "static_speed_m_per_s",
]
