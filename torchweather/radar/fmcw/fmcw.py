"""FmcwRadar: scatterers in the weather to the points that an FMCW radar reports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Rain, Snow, Weather, check_intensities
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_one_of
from torchweather.core.noise import flat_noise
from torchweather.core.precision import AtLeastSingle, outside_autocast
from torchweather.core.random import Variate, draw_variates, sample_seeds
from torchweather.radar.attenuation import PathAttenuation, WetRadome
from torchweather.radar.fmcw.beat_signal import beat_signal
from torchweather.radar.fmcw.cfar import CellAveragingCfar, Cfar, OrderStatisticCfar, window_correlation
from torchweather.radar.fmcw.detection import detections
from torchweather.radar.fmcw.range_doppler import check_cube, map_noise_dbm, range_doppler
from torchweather.radar.fmcw.scatterers import Scatterers
from torchweather.radar.fmcw.volume_echo import VolumeEcho
from torchweather.radar.fmcw.windows import WINDOWS, window
from torchweather.radar.sensor import Radar

__all__ = ["FmcwRadar", "FmcwResult", "cfar_for"]

CFARS = {"ca": CellAveragingCfar, "os": OrderStatisticCfar}
SMALLEST_MW = 1e-30  # keeps logarithms finite


@dataclass(frozen=True)
class FmcwResult:
    """Output of a simulated radar for a frame; lists, one entry a sample, for a batch.

    Args:
        points: ``(N, 6)``: x, y, z (m), radial speed (m/s), power (dBm), radar cross section (dBsm).
        snr_db: ``(N,)`` power over the noise of a beam.
        cell: ``(N, 2)`` Doppler and range bin of each point.
        power_dbm: ``(..., N_c, N_s)`` range-Doppler map: mean power of the channels.
    """

    points: Tensor | list[Tensor]
    snr_db: Tensor | list[Tensor]
    cell: Tensor | list[Tensor]
    power_dbm: Tensor


def cfar_for(radar: Radar, kind: str = "ca", window_name: str = "hann", **options: Any) -> Cfar:
    """The detector that fits a radar's range-Doppler map, summed over its channels.

    Args:
        radar: the sensor.
        kind: ``ca`` (cell averaging) or ``os`` (order statistic).
        window_name: of the map; neighbouring cells' noise is correlated by it.
        options: further fields of the detector, such as ``false_alarm_rate``.

    Example:
        >>> cfar_for(Radar.preset("awr1843-like")).looks
        12
    """
    check_arguments("cfar_for(radar: Radar, kind: str, window_name: str)", radar, kind, window_name)
    check_one_of("cfar", kind, CFARS, owner="cfar_for")
    correlation = tuple(window_correlation(window(window_name, length)) for length in (radar.chirps, radar.samples))
    found: Cfar = CFARS[kind](looks=radar.virtual_channels, correlation=correlation, **options)
    return found


class FmcwRadar(AtLeastSingle):
    """An FMCW radar with its weather: beat signal, thermal noise, range-Doppler map, CFAR, points.

    Weather enters where it does in nature: attenuation on the way to each scatterer and back, the film on the cover,
    and the echoes of drops and flakes in the beat signal.

    Args:
        radar: the sensor.
        weather: ``Rain``, ``Fog``, ``Snow``, a ``Mixture``, or ``None`` for clear air.
        window_name: of range and Doppler transform: ``rectangular``, ``hann``, ``hamming`` or ``blackman``.
        cfar: ``ca``, ``os``, or a detector (see ``cfar_for``).
        angles_per_cell: directions reported of one range-Doppler cell at most.
        dynamic_db: directions weaker by so much than the strongest of their cell are taken for sidelobes.
        noise: thermal noise in the samples.
        clutter: echoes of rain and snow in the samples.
        ego_speed_m_per_s: of the vehicle, forward; for the clutter's Doppler.
        radome_loss_db, radome_film_db, radome_film_exponent: as in ``RadarAttenuation``.
        rain_model, fog_model, snow_model: likewise.

    Note:
        Differentiable from scatterers to map; the points of a target follow its parameters too, which cells become
        points does not. Transmitters take turns, so a target faster than ``max_speed_m_per_s`` appears at a wrong
        speed and at a wrong angle.

    References:
        PHYSICS.md 6.

    Example:
        >>> radar = FmcwRadar(Radar.preset("awr1843-like"), Rain(rate_mm_per_h=25))
        >>> corner = Scatterers.from_spherical(torch.tensor([20.0]), 0.1, 0.0, rcs_dbsm=10.0, speed_m_per_s=-2.0)
        >>> points = radar(corner, radar.draw(corner, seed=1))
        >>> strongest = points[points[:, 4].argmax()]
        >>> bool((strongest[3] + 2.0).abs() < 0.07), bool((strongest[:3].norm() - 20.0).abs() < 0.15)
        (True, True)
    """

    def __init__(
        self,
        radar: Radar,
        weather: Weather | None = None,
        *,
        window_name: str = "hann",
        cfar: str | Cfar = "ca",
        angles_per_cell: int = 4,
        dynamic_db: float = 10.0,
        noise: bool = True,
        clutter: bool = True,
        ego_speed_m_per_s: float = 0.0,
        radome_loss_db: float = 0.0,
        radome_film_db: float = 0.0,
        radome_film_exponent: float = 1.0 / 3.0,
        rain_model: str = "p838",
        fog_model: str = "p840",
        snow_model: str = "dsd_mie",
    ) -> None:
        check_arguments(
            "FmcwRadar(radar: Radar, weather: Weather | None, window_name: str, angles_per_cell: int, "
            "dynamic_db: float, noise: bool, clutter: bool, ego_speed_m_per_s: float, radome_loss_db: float, "
            "radome_film_db: float, radome_film_exponent: float, rain_model: str, fog_model: str, snow_model: str)",
            radar,
            weather,
            window_name,
            angles_per_cell,
            dynamic_db,
            noise,
            clutter,
            ego_speed_m_per_s,
            radome_loss_db,
            radome_film_db,
            radome_film_exponent,
            rain_model,
            fog_model,
            snow_model,
        )
        super().__init__()
        Radar.check(radar, "radar", "awr1843-like", owner=self)
        if weather is not None and not isinstance(weather, Weather):
            raise InputTypeError(f"FmcwRadar: weather must be Rain, Fog, Snow, a Mixture or None; got {weather!r}.")
        check_one_of("window_name", window_name, WINDOWS, owner=self)
        check_at_least("angles_per_cell", angles_per_cell, 1, owner=self)
        check_at_least("dynamic_db", dynamic_db, 0.0, unit="dB", owner=self)
        self.radar, self.weather, self.window_name = radar, weather, window_name
        self.cfar = cfar_for(radar, cfar, window_name) if isinstance(cfar, str) else cfar
        self.angles_per_cell, self.dynamic_db, self.noise = int(angles_per_cell), float(dynamic_db), bool(noise)
        parts = () if weather is None else weather.parts
        if any(part.patch_log_std != 0.0 for part in parts):
            raise InputValueError(
                "FmcwRadar: expected weather without patches; set patch_log_std=0, or use RadarAttenuation."
            )
        self.path = PathAttenuation(parts, radar, rain_model, fog_model, snow_model) if parts else None
        rates = [part.intensity for part in parts if isinstance(part, Rain)]
        self.radome = WetRadome(rates[0] if rates else 0.0, radome_loss_db, radome_film_db, radome_film_exponent)
        falling = [part for part in parts if clutter and isinstance(part, (Rain, Snow))]
        self.volumes = nn.ModuleDict(
            {part.kind: VolumeEcho(part, radar, ego_speed_m_per_s=ego_speed_m_per_s) for part in falling}
        )

    # ---- calls -------------------------------------------------------------------------------------------------

    @outside_autocast
    def forward(self, scatterers: Scatterers, noise: Mapping[str, Tensor] | None = None) -> Tensor | list[Tensor]:
        """The points of a frame.

        Args:
            scatterers: ``(..., M)``, in clear air.
            noise: what ``draw`` gave; ``None`` draws anew.

        Returns:
            ``(N, 6)``: x, y, z (m), radial speed (m/s), power (dBm), radar cross section (dBsm); a list of them for a
            batch.
        """
        return self.run(scatterers, noise).points

    if TYPE_CHECKING:
        __call__ = forward

    @outside_autocast
    def run(self, scatterers: Scatterers, noise: Mapping[str, Tensor] | None = None) -> FmcwResult:
        """The points of a frame and the map that they come from; arguments as ``forward``."""
        return self.process(self.cube(scatterers, noise))

    @outside_autocast
    def draw(
        self, scatterers: Scatterers, generator: torch.Generator | None = None, seed: int | Tensor | None = None
    ) -> dict[str, Tensor]:
        """Noise for ``forward``: thermal noise of every sample, and the places and phases of rain and snow.

        Args:
            scatterers: only their batch shape counts.
            generator: torch generator that gives one integer a sample; ``None`` is the global one.
            seed: those integers themselves: a tensor of the batch shape, or the first of them.

        Returns:
            ``<stage>.<variate>`` to a tensor that leads with the batch shape.
        """
        batch = scatterers.speed_m_per_s.shape[:-1]
        seeds = sample_seeds(batch, generator, seed)
        drawn: dict[str, Tensor] = {}
        for stage, variates in self._variates().items():
            arrays = draw_variates(seeds, stage, variates, {})
            drawn |= {key: torch.from_numpy(value).reshape(*batch, *value.shape[1:]) for key, value in arrays.items()}
        return drawn

    def cube(self, scatterers: Scatterers, noise: Mapping[str, Tensor] | None = None) -> Tensor:
        """Samples of a frame, ``(..., V, N_c, N_s)`` complex64, square root of milliwatts; arguments as ``forward``."""
        if noise is None:
            noise = self.draw(scatterers)
        batch, count = scatterers.speed_m_per_s.shape[:-1], scatterers.speed_m_per_s.shape[-1]
        flat = Scatterers(
            scatterers.position_m.reshape(-1, count, 3),
            scatterers.speed_m_per_s.reshape(-1, count),
            scatterers.field_m.reshape(-1, count),
        )
        if self.weather is not None:
            check_intensities(self.weather, batch, owner=self)
        variates = {f"{stage}.{one.name}": one for stage, several in self._variates().items() for one in several}
        own = flat_noise(noise, variates, {}, batch, owner=self)
        own = {key: value.to(flat.speed_m_per_s.device) for key, value in own.items()}
        cube = beat_signal(flat, self.radar, attenuation_db=self._loss_db(flat))
        cover_loss_db = self.radome.two_way_db(len(cube))
        for kind, volume in self._volumes().items():
            white = {name: own[f"{kind}_volume.{name}"] for name in ("real", "imaginary")}
            assert self.path is not None
            cube = cube + volume(white, self.path, cover_loss_db)
        if self.noise:
            level = math.sqrt(0.5 * 10.0 ** (self.radar.noise_power_dbm / 10.0))
            cube = cube + level * torch.complex(own["thermal_noise.real"], own["thermal_noise.imaginary"])
        return cube.reshape(*batch, *cube.shape[1:])

    def process(self, cube: Tensor) -> FmcwResult:
        """Map and points of samples, simulated or measured.

        Args:
            cube: ``(..., V, N_c, N_s)`` complex, square root of milliwatts.
        """
        check_cube(cube, self.radar, self)
        batch = cube.shape[:-3]
        channels = range_doppler(cube.reshape(-1, *cube.shape[-3:]), self.radar, self.window_name)
        power = torch.view_as_real(channels).square().mean(1).sum(-1)  # channels first: one long pass
        if not math.isfinite(float(power.detach().sum())):
            raise InputValueError(
                "FmcwRadar: cube must be finite, square root of milliwatts; got NaN or infinity in it."
            )
        found = [
            detections(*frame, self.cfar, self.radar, self.window_name, self.angles_per_cell, self.dynamic_db)
            for frame in zip(channels, power, strict=True)
        ]
        power_dbm = 10.0 * power.clamp_min(SMALLEST_MW).log10().reshape(*batch, *power.shape[1:])
        points, snr, cell = ([getattr(frame, name) for frame in found] for name in ("points", "snr_db", "cell"))
        if not batch:
            return FmcwResult(points[0], snr[0], cell[0], power_dbm)
        return FmcwResult(points, snr, cell, power_dbm)

    @property
    def list_sensor(self) -> Radar:
        """The radar as the sensor of its own lists, for ``RadarAttenuation``: with the noise floor of its beams."""
        beam_noise_dbm = map_noise_dbm(self.radar, self.window_name) - 10.0 * math.log10(self.radar.virtual_channels)
        return replace(self.radar, noise_floor_db=beam_noise_dbm)

    # ---- pieces ------------------------------------------------------------------------------------------------

    def _variates(self) -> dict[str, tuple[Variate, ...]]:
        """Variates that are drawn, by the name of their stream."""
        found = {f"{kind}_volume": volume.variates() for kind, volume in self._volumes().items()}
        if self.noise:
            shape = (self.radar.virtual_channels, self.radar.chirps, self.radar.samples)
            found["thermal_noise"] = tuple(Variate(name, "normal", shape) for name in ("real", "imaginary"))
        return found

    def _volumes(self) -> dict[str, VolumeEcho]:
        return dict(self.volumes.items())  # type: ignore[arg-type]

    def _loss_db(self, scatterers: Scatterers) -> Tensor:
        """Loss of each scatterer's echo on its path and at the cover, dB."""
        range_m = scatterers.range_m
        loss = self.radome.two_way_db(len(range_m)).to(range_m)[:, None].expand(range_m.shape)
        return loss if self.path is None else loss + self.path.two_way_db(range_m)
