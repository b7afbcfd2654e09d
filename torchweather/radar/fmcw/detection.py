"""Detection: cells of the range-Doppler map above their threshold, and the points that they mean."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.physics import target_rcs_dbsm
from torchweather.radar.fmcw.angles import spectrum_peaks, steering
from torchweather.radar.fmcw.cfar import Cfar
from torchweather.radar.fmcw.range_doppler import range_m_of_bin, speed_m_per_s_of_bin, transmitter_rotation
from torchweather.radar.fmcw.windows import migration_share, tone_place_and_loss
from torchweather.radar.sensor import Radar

__all__ = ["Detections", "beam_amplitude", "detections", "local_maxima"]


@dataclass(frozen=True)
class Detections:
    """The points of one frame.

    Args:
        points: ``(N, 6)``: x, y, z (m), radial speed (m/s), power (dBm), radar cross section (dBsm), float32.
        snr_db: ``(N,)`` power over the noise of a beam.
        cell: ``(N, 2)`` Doppler and range bin.
    """

    points: Tensor
    snr_db: Tensor
    cell: Tensor


def local_maxima(power: Tensor) -> Tensor:
    """Cells that are as strong as any of their eight neighbours, bool.

    Args:
        power: ``(..., N_c, N_s)``; the Doppler axis is a circle.
    """
    beside = functional.pad(power, (1, 1), value=-torch.inf)
    along_range = torch.maximum(torch.maximum(beside[..., :-2], beside[..., 2:]), power)
    wrapped = torch.cat([along_range[..., -1:, :], along_range, along_range[..., :1, :]], -2)
    highest = torch.maximum(torch.maximum(wrapped[..., :-2, :], wrapped[..., 2:, :]), along_range)
    return power >= highest


def detections(
    channels: Tensor,
    power: Tensor,
    cfar: Cfar,
    radar: Radar,
    window_name: str,
    angles_per_cell: int,
    dynamic_db: float,
) -> Detections:
    """Points of one frame's map: the local maxima that the detector takes.

    Range and speed come from the powers beside a peak, less the noise, which the window's own response turns into a
    place between bins; direction from the channels' phases after the transmitters' turns are taken out.

    Args:
        channels: ``(V, N_c, N_s)`` complex map of each channel.
        power: ``(N_c, N_s)`` mean power of the channels.
        cfar: the detector.
        radar: the sensor.
        window_name: of the map.
        angles_per_cell: directions of one cell at most.
        dynamic_db: directions that much below the strongest of a cell are taken for sidelobes.
    """
    rows, columns = power.shape
    doppler, column = local_maxima(power.detach()).nonzero(as_tuple=True)
    detected, noise = cfar.detect_at(power.detach(), doppler, column)
    doppler, column = doppler[detected], column[detected]

    def beside(step_doppler: int, step_range: int) -> Tensor:
        near = column + step_range
        inside = (near >= 0) & (near < columns)
        value = power[(doppler + step_doppler) % rows, near.clamp(0, columns - 1)]
        return torch.where(inside, (value - noise).clamp_min(0.0), 0.0)

    along_doppler, share_doppler = tone_place_and_loss(beside(-1, 0), beside(1, 0), window_name, rows)
    along_range, share_range = tone_place_and_loss(beside(0, -1), beside(0, 1), window_name, columns)
    speed = speed_m_per_s_of_bin(doppler + along_doppler, radar)
    range_m = range_m_of_bin(column + along_range, speed, radar)

    own = channels[:, doppler, column].T * transmitter_rotation(speed, radar).to(channels.dtype)
    cosines, strength = spectrum_peaks(own, radar, angles_per_cell, dynamic_db)
    beam_noise = noise / radar.virtual_channels
    snr_db = 10.0 * (strength / beam_noise[:, None]).log10()
    row, peak = ((snr_db >= radar.detection_snr_db) & (range_m > 0)[:, None]).nonzero(as_tuple=True)

    left, up = cosines[row, peak].unbind(-1)
    ahead = (1.0 - left.square() - up.square()).clamp_min(0.0).sqrt()
    direction = torch.stack([ahead, left, up], -1)
    crossed = speed * (radar.frame_time_s / radar.range_resolution_m)
    share = share_doppler * share_range * migration_share(crossed, window_name, rows, columns)
    power_dbm = 10.0 * (strength[row, peak] / share[row]).log10()
    gain_dbi = 2.0 * radar.gain_dbi(torch.atan2(left, ahead), torch.asin(up))
    rcs_dbsm = target_rcs_dbsm(
        power_dbm,
        range_m[row],
        frequency_ghz=radar.frequency_ghz,
        transmit_power_dbm=radar.transmit_power_dbm,
        antenna_gain_dbi=gain_dbi,
        loss_db=radar.loss_db,
    )
    columns_of_point = [range_m[row, None] * direction, speed[row, None], power_dbm[:, None], rcs_dbsm[:, None]]
    points = torch.cat([value.float() for value in columns_of_point], -1)
    return Detections(points, snr_db[row, peak].float(), torch.stack([doppler[row], column[row]], -1))


def beam_amplitude(channels: Tensor, points: Tensor, cell: Tensor, radar: Radar) -> Tensor:
    """``(N,)`` complex amplitude in the beam towards each point, in its cell of a map.

    Args:
        channels: ``(V, N_c, N_s)`` complex map of each channel: the points' own, or that of a part of its samples.
        points: ``(N, 6)`` as of ``Detections``.
        cell: ``(N, 2)`` likewise.
        radar: the sensor.
    """
    direction = points[:, 1:3] / torch.linalg.vector_norm(points[:, :3], dim=-1, keepdim=True)
    weights = steering(direction, radar) * transmitter_rotation(points[:, 3], radar)
    found: Tensor = (channels[:, cell[:, 0], cell[:, 1]].T * weights).sum(-1)
    return found
