"""Detections of a power map: CFAR over range and azimuth (or Doppler), and the points of the cells that it takes."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between
from torchweather.radar.fmcw.cfar import CellAveragingCfar, Cfar
from torchweather.radar.fmcw.detection import local_maxima
from torchweather.radar.power_map.clutter import map_noise_floor_dbm
from torchweather.radar.power_map.noise_floor import noise_floor_db
from torchweather.radar.power_map.power_map import RadarPowerMap
from torchweather.radar.power_map.receiver import oversampled_taps
from torchweather.radar.sensor import Radar

__all__ = ["map_cfar", "map_detections"]

NONE_DB = -300.0  # power of a cell that has none
LEAST_CORRELATION = 0.01


def map_cfar(power_map: RadarPowerMap, sensor: Radar, false_alarm_rate: float = 1e-4, looks: int = 1) -> Cfar:
    """A cell-averaging CFAR for a map: along the range, with the guard as wide as the resolution.

    Args:
        power_map: the map.
        sensor: its range resolution over the bin says how far neighbouring bins share their noise.
        false_alarm_rate: of a cell of noise.
        looks: as of the map.
    """
    check_arguments(
        "map_cfar(power_map: RadarPowerMap, sensor: Radar, false_alarm_rate: float, looks: int)",
        power_map,
        sensor,
        false_alarm_rate,
        looks,
    )
    taps = oversampled_taps(max(1.0, sensor.range_resolution_m / power_map.range_bin_m)).double()
    shared = [abs(float((taps[lag:] * taps[: len(taps) - lag]).sum())) for lag in range(1, len(taps))]
    last = max((lag for lag, one in enumerate(shared, 1) if one >= LEAST_CORRELATION), default=0)
    guard = max(2, last)
    room = (len(power_map.axes.range_m) - 1) // 2 - guard
    return CellAveragingCfar(
        false_alarm_rate=false_alarm_rate,
        guard=(0, guard),
        training=(0, max(1, min(4 * guard, room))),
        looks=looks,
        correlation=((), tuple(shared[:last])),
    )


def map_detections(
    power_map: RadarPowerMap,
    sensor: Radar,
    cfar: Cfar | None = None,
    *,
    noise_db: float | None = None,
    looks: int = 1,
) -> Tensor:
    """Points of the local maxima that a CFAR takes.

    A third and fourth dimension (Doppler, elevation) are reduced to the strongest cell first, which gives the point's
    speed and elevation.

    Args:
        power_map: of range and azimuth, or range and Doppler, and whatever else.
        sensor: for the CFAR, and for the cross section by the radar equation, over the noise.
        cfar: over (azimuth or Doppler, range); ``None``: ``map_cfar``.
        noise_db: mean noise in the map's unit; ``None``: ``noise_floor_db``.
        looks: independent looks whose mean power a cell holds.

    Returns:
        ``(N, 6)`` float32: x, y, z (m), speed (m/s; 0 without a Doppler axis), power (dB, the map's unit), radar cross
        section (dBsm), in the order of azimuth and range.

    Note:
        The azimuths are taken as a circle, which only a turning radar's are: where others end, their first and last
        columns are neighbours of each other.
    """
    check_arguments(
        "map_detections(power_map: RadarPowerMap, sensor: Radar, noise_db: float | None, looks: int)",
        power_map,
        sensor,
        noise_db,
        looks,
    )
    if noise_db is not None:
        check_between("noise_db", noise_db, -400.0, 400.0, unit="dB", owner="map_detections")
    axes = power_map.axes
    names = ("azimuth", "elevation", "doppler", "range")
    kept = [name for name in names if name in axes.dims]
    decibels = power_map.decibels.permute(*(axes.dims.index(name) for name in kept))
    floor_db = noise_floor_db(power_map, looks) if noise_db is None else float(noise_db)
    across = next((name for name in kept if name != "range"), None)
    others = [name for name in kept if name not in (across, "range")]
    sizes = [decibels.shape[kept.index(name)] for name in others]
    if across is None:
        decibels = decibels[None]
    flat = decibels.reshape(decibels.shape[0], -1, decibels.shape[-1])
    strongest, which = flat.max(1)  # (rows, R)
    over_noise = torch.exp(math.log(10.0) / 10.0 * (strongest.clamp_min(NONE_DB) - floor_db))
    detector = map_cfar(power_map, sensor, looks=looks) if cfar is None else cfar
    check_arguments("map_detections(cfar: CellAveragingCfar | OrderStatisticCfar)", detector)
    if strongest.shape[0] > 2:
        row, column = local_maxima(over_noise).nonzero(as_tuple=True)
    else:
        row, column = torch.ones_like(over_noise, dtype=torch.bool).nonzero(as_tuple=True)
    found, _ = detector.detect_at(over_noise, row, column)
    row, column = row[found], column[found]
    index: dict[str, Tensor] = {} if across is None else {across: row}
    rest = which[row, column]
    for name, size in zip(reversed(others), reversed(sizes), strict=True):
        index[name] = rest % size
        rest = rest // size
    zero = torch.zeros_like(row)
    at = {name: axes.axis(name).to(row.device)[index.get(name, zero)] for name in ("azimuth", "elevation", "doppler")}
    range_m = axes.axis("range").to(row.device)[column]
    level = at["elevation"].cos()
    along = torch.stack([level * at["azimuth"].cos(), level * at["azimuth"].sin(), at["elevation"].sin()], -1)
    power_db = strongest[row, column].double()
    power_dbm = power_db - floor_db + map_noise_floor_dbm(sensor, axes)
    rcs_dbsm = power_dbm - sensor.constant_db + 40.0 * range_m.log10()
    return torch.cat([range_m[:, None] * along, torch.stack([at["doppler"], power_db, rcs_dbsm], -1)], -1).float()
