r"""SoftReturn: the return of fog in a LiDAR's beams, a continuous medium whose signal is counted in photons.

The receiver sees the pulse spread over the fog in front of it,

    S(r) = beta (c/2) int_0^{2 tau} sin^2(pi t / 2 tau) f(r + c tau/2 - c t/2) dt,   f(r) = xi(r) exp(-2 alpha r) / r^2,

with tau the pulse width (FWHM); r is counted so that a hard target stands at its own range. Within one pulse length
l = c tau/2 the photons of S are one count, Poisson distributed, and counts a pulse length apart are independent. The
reading of a beam is the largest count, at its range. With F(e; S) the distribution of a count,

    P(largest <= e) = prod F = exp(-Lambda(e, R)),   Lambda(e, R) = int_0^R -ln F(e; S(r)) dr / l,

so the strongest return of fog is drawn from a table of Lambda just as the strongest particle is, and the pulse length
in which it lies follows from the derivative in e in the same way. Within a pulse length S(r) above is its largest value
there, and that is the place which is reported: a receiver as slow as the pulse has one reading of a narrow peak.

References:
    PHYSICS.md 5.3 (photons), 5.8 (waveform).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor, nn

from torchweather.errors import check_one_of
from torchweather.random import Variate
from torchweather.sensors import Lidar
from torchweather.stages.beam import Beam, RangeGrid
from torchweather.stages.fog_optics import FogOptics, mor_range_m
from torchweather.stages.strongest import expected_number
from torchweather.weather import Fog

__all__ = ["SoftReturn"]

BACKSCATTERS = ("mie", "hahner")
HAHNER_BETA_MOR_PER_SR = 0.046  # Rasshofer 2011, Hahner 2021: beta = 0.046 / MOR, a lidar ratio of 65 sr
PULSE_NODES = 32
COUNT_NODES = 65  # cells by powers of two: the search in strongest.py halves them
FEWEST_PHOTONS = 0.1  # of those at the threshold: a reading below it is not drawn
PHOTON_LOW, PHOTON_HIGH, PHOTON_NODES = 1e-2, 1e5, 2048
NEVER = 1e-30  # -ln F of a reading that never occurs, so that logarithms stay finite


@lru_cache(maxsize=8)
def _count_table(roots: tuple[float, float]) -> Tensor:
    """ln(-ln F) of a reading at the nodes, ``(COUNT_NODES, PHOTON_NODES)``, over the ln of the expected photons.

    ``F(n; mu) = Q(n + 1/2, mu)``: the Poisson distribution continued between the integers with the mean kept.
    """
    reading = torch.linspace(roots[0], roots[1], COUNT_NODES, dtype=torch.float64)[:, None] ** 2 + 0.5
    mean = torch.logspace(math.log10(PHOTON_LOW), math.log10(PHOTON_HIGH), PHOTON_NODES, dtype=torch.float64)
    above, below = torch.special.gammainc(reading, mean), torch.special.gammaincc(reading, mean)
    # Far in the tail, where Q underflows: Q(a, mu) = mu^(a-1) exp(-mu) / Gamma(a).
    far = mean - (reading - 1) * mean.log() + torch.lgamma(reading)
    minus_log = torch.where(above < 0.5, -torch.log1p(-above.clamp_max(0.5)), -below.clamp_min(1e-280).log())
    minus_log = torch.where(below < 1e-270, far, minus_log)
    return minus_log.clamp_min(NEVER).log().float()


class SoftReturn(nn.Module):
    """The return of fog in a LiDAR's beams, one a beam; used by ``ParticleReturns``.

    Args:
        weather: the fog.
        sensor: the LiDAR.
        backscatter: ``mie`` (Mie theory over the fog's own distribution at the laser's wavelength) or ``hahner``
            (0.046 / MOR, with the visible MOR).
    """

    mor_m: Tensor
    count_table: Tensor
    pulse_length_m: Tensor
    photons_at_threshold: Tensor
    pulse_place: Tensor
    pulse_weight: Tensor

    echoes = 1
    kind = "fog"

    def __init__(self, weather: Fog, sensor: Lidar, *, backscatter: str = "mie") -> None:
        super().__init__()
        check_one_of("fog_backscatter", backscatter, BACKSCATTERS, owner=self)
        self.weather, self.backscatter = weather, backscatter
        self.grid = RangeGrid.of(sensor)
        self.optics = FogOptics(weather, float(sensor.wavelength_nm))
        place, weight = np.polynomial.legendre.leggauss(PULSE_NODES)
        weight = weight * np.cos(0.5 * np.pi * place) ** 2  # sin^2 of the pulse, from its middle; integral 1
        for name, value in (
            ("mor_m", weather.mor_m),
            ("pulse_length_m", sensor.pulse_length_m),
            ("photons_at_threshold", sensor.photons_at_threshold),
        ):
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.register_buffer("pulse_place", torch.from_numpy(place).float(), persistent=False)
        self.register_buffer("pulse_weight", torch.from_numpy(weight).float(), persistent=False)
        self._set_readings(sensor)

    def _set_readings(self, sensor: Lidar) -> None:
        """Nodes of the reading, uniform in its square root, which has the same photon noise everywhere."""
        with torch.no_grad():
            low, high = mor_range_m(self.weather)
            mor_m = torch.logspace(math.log10(low), math.log10(high), 32)
            beam = Beam(sensor)
            # Extinction at its least, the geometric optics of Koschmieder's law.
            most = self._signal(beam, mor_m, 2.9 / mor_m, self.grid.quadrature_m).max() / beam.threshold
        photons = sensor.photons_at_threshold
        brightest = float(most) * photons
        self.root_low = math.sqrt(FEWEST_PHOTONS * photons)
        self.root_high = max(math.sqrt(brightest) + 3.0, 2.0 * math.sqrt(photons) + 3.0)
        self.root_step = (self.root_high - self.root_low) / (COUNT_NODES - 1)
        self.register_buffer("count_table", _count_table((self.root_low, self.root_high)), persistent=False)

    def backscatter_per_m_sr(self, mor_m: Tensor) -> Tensor:
        """beta, 1/(m sr), of the shape of ``mor_m``."""
        if self.backscatter == "hahner":
            return HAHNER_BETA_MOR_PER_SR / mor_m
        return self.optics.backscatter_per_m_sr(mor_m)

    def signal(self, beam: Beam, extinction_per_m: Tensor, range_m: Tensor) -> Tensor:
        """Expected soft return S over the system constant, ``(B, ...)``, at ranges ``(...)``, 1/(m^2 sr)."""
        return self._signal(beam, self.mor_m.reshape(-1), extinction_per_m, range_m)

    def _signal(self, beam: Beam, mor_m: Tensor, extinction_per_m: Tensor, range_m: Tensor) -> Tensor:
        # (..., PULSE_NODES): where in the fog the light of each part of the pulse comes from.
        source_m = (range_m[..., None] - self.pulse_length_m * self.pulse_place).clamp_min(1e-3)
        extinction = extinction_per_m.reshape(-1, *([1] * source_m.ndim))
        response = beam.near_response(source_m) / source_m.square() * torch.exp(-2.0 * extinction * source_m)
        spread = (response * self.pulse_weight).sum(-1)
        beta = self.backscatter_per_m_sr(mor_m).reshape(-1, *([1] * range_m.ndim))
        return beta * self.pulse_length_m * spread

    def between(self, beam: Beam, extinction_per_m: Tensor, density_scale: Tensor | None = None) -> Tensor:
        """Lambda from one node of the reading to the next up to each node of range, ``(B, E, P)``.

        Args:
            beam: the sensor's.
            extinction_per_m: ``(B,)`` of all weather together.
            density_scale: ``(B,)`` droplets over those of the visibility; ``None`` is 1.
        """
        signal = self._largest(self.signal(beam, extinction_per_m, self.grid.quadrature_m))  # (B, cells, G)
        if density_scale is not None:
            signal = signal * density_scale.to(signal)[:, None, None]
        photons = signal * (self.photons_at_threshold / beam.threshold)
        step = math.log(PHOTON_HIGH / PHOTON_LOW) / (PHOTON_NODES - 1)
        position = (photons.clamp_min(1e-20).log() - math.log(PHOTON_LOW)) / step
        table = self.count_table.to(position.dtype)
        node = position.detach().floor().clamp(0, PHOTON_NODES - 2).to(torch.int64)
        flat = node.reshape(-1)
        low, high = table[:, flat], table[:, flat + 1]  # (E, B cells G)
        share = (position - node).reshape(-1)
        # Below the table F is a power of the mean: the first cell goes on.
        per_count = torch.exp(torch.lerp(low, high, share)).reshape(COUNT_NODES, *photons.shape).transpose(0, 1)
        per_m = per_count / self.pulse_length_m
        next_per_m = torch.cat([per_m[:, 1:], torch.zeros_like(per_m[:, :1])], 1)
        return self.grid.integrated((per_m - next_per_m).clamp_min(0.0))

    def expected_above(self, beam: Beam, signal: Tensor, extinction_per_m: Tensor, reach_m: Tensor) -> Tensor:
        """Lambda(e, R) with ``exp(-Lambda)`` the probability that no reading exceeds ``signal``, ``(B, N)``."""
        photons = (signal / beam.threshold * self.photons_at_threshold).clamp_min(1e-12)
        row = ((torch.sqrt(photons) - self.root_low) / self.root_step).clamp(0.0, COUNT_NODES - 1)
        return expected_number(self.between(beam, extinction_per_m), row, self.grid.position(reach_m))

    def located_m(self, range_m: Tensor, beam: Beam, extinction_per_m: Tensor) -> Tensor:
        """Where a reading at a range ``(B, N)`` is reported: at the maximum of S, no farther off than half a pulse."""
        with torch.no_grad():
            peak_m = self._peak_m(self.signal(beam, extinction_per_m, self.grid.quadrature_m))
        return self._towards(peak_m, range_m)

    def drawn_before_m(self, range_m: Tensor, beam: Beam, extinction_per_m: Tensor) -> Tensor:
        """Range ``(B, N)`` before which a reading must be drawn to be reported before ``range_m``."""
        with torch.no_grad():
            peak_m = self._peak_m(self.signal(beam, extinction_per_m, self.grid.quadrature_m))
        half_m = 0.5 * self.pulse_length_m
        return torch.where(range_m >= peak_m, range_m + half_m, (range_m - half_m).clamp_min(0.0))

    def _peak_m(self, signal: Tensor) -> Tensor:
        """Range ``(B, 1)`` at which a waveform ``(B, cells, G)`` is largest."""
        return self.grid.quadrature_m.flatten()[signal.flatten(1).argmax(1)][:, None]

    def _towards(self, peak_m: Tensor, range_m: Tensor) -> Tensor:
        half_m = 0.5 * self.pulse_length_m
        return torch.minimum(torch.maximum(peak_m, range_m - half_m), range_m + half_m)

    def _largest(self, signal: Tensor) -> Tensor:
        """Largest value of a waveform ``(B, cells, G)`` within half a pulse length; it rises once and falls once."""
        nodes = self.grid.quadrature_m
        cells, each = nodes.shape
        wanted_m = self._towards(self._peak_m(signal.detach()), nodes.flatten())  # (B, cells G)
        place = self.grid.position(wanted_m)
        cell = place.floor().clamp(0, cells - 1)
        inside = self.grid.position(nodes[0])
        index = cell * each + ((place - cell)[..., None] >= inside).sum(-1) - 1
        index = index.clamp(0, cells * each - 2).to(torch.int64)
        below_m, above_m = nodes.flatten()[index], nodes.flatten()[index + 1]
        share = ((wanted_m - below_m) / (above_m - below_m)).clamp(0.0, 1.0)
        flat = signal.flatten(1)
        found = torch.lerp(flat.gather(1, index), flat.gather(1, index + 1), share)
        return torch.maximum(flat, found).reshape(signal.shape)

    def start(self, reach_m: Tensor) -> Tensor | None:
        """Place on the grid where the fog begins; ``None`` is its first node."""
        return None

    def signal_at(self, row: Tensor, beam: Beam) -> Tensor:
        """Signal at a place on the axis of readings."""
        photons = (self.root_low + self.root_step * row).square()
        return photons * (beam.threshold / self.photons_at_threshold)

    def parameters_of_table(self) -> tuple[Tensor, ...]:
        """What ``between`` depends on besides the beam and the extinction, as far as it can change."""
        return self.mor_m, self.pulse_length_m, self.photons_at_threshold

    def variates(self) -> tuple[Variate, ...]:
        """Arrival and place of the strongest reading of each beam."""
        return Variate("fog_arrival", "uniform", (1, "N")), Variate("fog_place", "uniform", (1, "N"))
