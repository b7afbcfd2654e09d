r"""Volume echo: what all the drops or flakes in front of a radar add to its samples.

They are too many to list and too many for single ones to matter: what they add is a complex Gaussian field, known once
its covariance is. Range bin r, at the distance R, gets the power per channel

    P(r) = [P_t G_t G_r lambda^2 / ((4 pi)^3 L)] eta dR / R^2 10^(-2 gamma R / 10) sum_d w_d,   w_d = g(d) dOmega

with the two-way pattern g over the directions d: falling with the square of the range. Doppler bin f of direction d
holds the share S(f | d), a Gaussian about the radial speed of the drops there, and between channels the covariance is
that of the plane waves from all directions,

    C(f) = sum_d w_d S(f | d) a(f, d) a(f, d)^H,   a = exp(j [4 pi v k T_c / lambda - pi u . p])

A draw is a factor of C(f) times white noise in every cell, and the inverse transform of that is the samples.

References:
    PHYSICS.md 6.2, 6.4, 6.5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, check_between
from torchweather.core.random import Variate
from torchweather.radar.attenuation import PathAttenuation
from torchweather.radar.clutter import DB, FallingReflectivity, view_rad
from torchweather.radar.sensor import Radar

__all__ = ["VolumeEcho"]

DIRECTIONS_PER_BEAM = 3.0  # of the sum over directions; halving them changes a channel's covariance by less than 1e-3
FEWEST_DIRECTIONS = 9
FOLDS = 2  # of the Doppler spectrum over the unambiguous speeds, either way
JITTER = 1e-5  # of a channel's power, as white noise: keeps the covariance positive in single precision


class VolumeEcho(nn.Module):
    """The echo of rain or snow in a radar's samples.

    Args:
        weather: ``Rain`` or ``Snow``.
        radar: the sensor.
        near_m: the volume begins there; 1 m is generic (unverified).
        ego_speed_m_per_s: of the vehicle, forward.
        turbulence_m_per_s: standard deviation of the air's speed within a cell; 0.5 is generic (unverified).

    Note:
        Homogeneous weather out to the unambiguous range; what lies beyond does not fold back. Drops keep their range
        bin within a frame.

    References:
        PHYSICS.md 6.5.
    """

    def __init__(
        self,
        weather: Rain | Snow,
        radar: Radar,
        *,
        near_m: float = 1.0,
        ego_speed_m_per_s: float = 0.0,
        turbulence_m_per_s: float = 0.5,
    ) -> None:
        check_arguments(
            "VolumeEcho(weather: Rain | Snow, radar: Radar, near_m: float, ego_speed_m_per_s: float, "
            "turbulence_m_per_s: float)",
            weather,
            radar,
            near_m,
            ego_speed_m_per_s,
            turbulence_m_per_s,
        )
        super().__init__()
        if not isinstance(weather, (Rain, Snow)):
            raise InputTypeError(f"VolumeEcho: weather must be Rain or Snow; got {type(weather).__name__}.")
        check_between("near_m", near_m, 0.0, radar.max_range_m, unit="m", owner=self)
        check_between("ego_speed_m_per_s", ego_speed_m_per_s, -100.0, 100.0, unit="m/s", owner=self)
        check_between("turbulence_m_per_s", turbulence_m_per_s, 0.0, 100.0, unit="m/s", owner=self)
        self.weather, self.radar, self.near_m = weather, radar, float(near_m)
        self.ego_speed_m_per_s, self.turbulence_m_per_s = float(ego_speed_m_per_s), float(turbulence_m_per_s)
        self.falling = FallingReflectivity(weather, radar.frequency_ghz)

    def variates(self) -> tuple[Variate, ...]:
        """White noise of every cell of the map of every channel."""
        shape = (self.radar.virtual_channels, self.radar.chirps, self.radar.samples)
        return tuple(Variate(name, "normal", shape) for name in ("real", "imaginary"))

    def forward(self, noise: Mapping[str, Tensor], path: PathAttenuation, cover_loss_db: Tensor) -> Tensor:
        """Samples ``(B, V, N_c, N_s)`` complex64, square root of milliwatts.

        Args:
            noise: ``real`` and ``imaginary``, ``(B, V, N_c, N_s)``.
            path: the attenuation of all weather.
            cover_loss_db: ``(B,)`` two-way loss of the cover.
        """
        white = torch.complex(noise["real"].float(), noise["imaginary"].float()) * math.sqrt(0.5)
        batch = len(white)
        eta, fall, fall_std = (value.float() for value in self.falling(batch))
        power = self._power_mw(eta, path, cover_loss_db)
        factor = torch.linalg.cholesky(self.covariance(fall, fall_std))
        # (B, N_c, V, V) times (B, N_c, V, N_s)
        cells = (factor @ white.transpose(1, 2)).transpose(1, 2) * _root(power)[:, None, None]
        found: Tensor = torch.fft.ifft2(cells, norm="forward")
        return found

    def _power_mw(self, eta: Tensor, path: PathAttenuation, cover_loss_db: Tensor) -> Tensor:
        """``(B, N_s)`` power per steradian of the pattern that each range bin sends back."""
        radar = self.radar
        range_m = torch.arange(radar.samples, device=eta.device) * radar.range_resolution_m
        there = range_m >= max(self.near_m, 0.5 * radar.range_resolution_m)
        safe_m = torch.where(there, range_m, 1.0).expand(len(eta), -1)
        loss_db = path.two_way_db(safe_m) + cover_loss_db.to(eta)[:, None]
        level = torch.exp(DB * (radar.constant_db - loss_db)) * radar.range_resolution_m / safe_m.square()
        return torch.where(there, eta[:, None] * level, 0.0)

    def covariance(self, fall_m_per_s: Tensor, fall_std_m_per_s: Tensor) -> Tensor:
        """Covariance of the channels in each Doppler bin, ``(B, N_c, V, V)`` complex64, per unit of ``_power_mw``.

        Args:
            fall_m_per_s, fall_std_m_per_s: ``(B,)`` mean and standard deviation of the fall speed.
        """
        radar, device = self.radar, fall_m_per_s.device
        along, weight = self._directions(device)
        wind = along.new_tensor(self.weather.wind_m_per_s)
        still = along @ wind - self.ego_speed_m_per_s * along[:, 0]
        mean = still - fall_m_per_s[:, None] * along[:, 2]  # (B, D)
        std = (self.turbulence_m_per_s**2 + (fall_std_m_per_s[:, None] * along[:, 2]) ** 2).sqrt()
        std = std.clamp_min(0.5 * radar.speed_resolution_m_per_s)
        period = 2.0 * radar.max_speed_m_per_s
        bins = (torch.arange(radar.chirps, device=device) + radar.chirps // 2) % radar.chirps - radar.chirps // 2
        off = bins[:, None] * radar.speed_resolution_m_per_s - mean[:, None]  # (B, N_c, D), bins as the transform's
        off = off - period * (off / period).round()
        folds = torch.arange(-FOLDS, FOLDS + 1, device=device) * period
        spectrum = torch.exp(-0.5 * ((off[..., None] + folds) / std[:, None, :, None]).square()).sum(-1)
        share = weight * spectrum / spectrum.sum(1, keepdim=True)
        channel = torch.arange(radar.virtual_channels, device=device)
        turn_s = (channel // radar.receivers) * radar.chirp_period_s
        array = -0.5 * (along[:, 1:].double() @ radar.virtual_half_wavelengths.to(device).T)
        turns = 2.0 / radar.wavelength_m * (mean[:, None] + off)[..., None].double() * turn_s + array
        phase = (2.0 * math.pi * (turns - turns.round())).float()
        waves = torch.polar(share.sqrt()[..., None].expand(phase.shape).contiguous(), phase)  # (B, N_c, D, V)
        covariance = waves.transpose(-1, -2) @ waves.conj()
        # Of this bin's own power, and of the mean bin's, where the spectrum ends.
        floor = JITTER * share.sum(-1) + JITTER**2 * weight.sum() / radar.chirps
        return covariance + floor[..., None, None] * torch.eye(radar.virtual_channels, device=device)

    def _directions(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Unit vectors ``(D, 3)`` over the view and their weights ``(D,)``: two-way pattern times solid angle."""
        radar = self.radar
        axes = []
        for axis, view in enumerate(view_rad(radar)):
            positions = radar.virtual_half_wavelengths[:, axis]
            elements = float(positions.max() - positions.min()) + 1.0
            number = max(FEWEST_DIRECTIONS, math.ceil(DIRECTIONS_PER_BEAM * view * elements / 2.0))
            axes.append(((torch.arange(number, device=device) + 0.5) / number - 0.5) * view)
        azimuth, elevation = torch.meshgrid(*axes, indexing="ij")
        flat = torch.cos(elevation)
        along = torch.stack([flat * torch.cos(azimuth), flat * torch.sin(azimuth), torch.sin(elevation)], -1)
        pattern = torch.exp(2.0 * DB * (radar.gain_dbi(azimuth, elevation) - radar.antenna_gain_dbi))
        cell_sr = flat * math.prod(view_rad(radar)) / azimuth.numel()
        return along.reshape(-1, 3), (pattern * cell_sr).reshape(-1)


def _root(power: Tensor) -> Tensor:
    """Square root whose gradient at 0 is 0."""
    there = power > 0
    return torch.where(there, torch.where(there, power, 1.0).sqrt(), 0.0)
