r"""SoftReturn: the return of fog in a LiDAR's beams, a continuous medium whose signal is counted in photons.

The receiver sees the pulse spread over the fog in front of it,

    S(r) = beta (c/2) int_0^{2 tau} sin^2(pi t / 2 tau) f(r + c tau/2 - c t/2) dt,   f(r) = xi(r) exp(-2 alpha r) / r^2,

with tau the pulse width (FWHM); r is counted so that a hard target stands at its own range. The photons of S within one
pulse length l = c tau/2 are Poisson distributed. The receiver's response is the pulse itself, so that this noise is
correlated as sin^2 with itself, over about a pulse length. The reading of a beam is the largest value of the waveform.

That is a receiver that counts the light of a short flash in a gate of the pulse's shape (``gate``). A ``matched``
filter answers the light of a pulse with the pulse: S has the autocorrelation of sin^2 over its peak in place of sin^2,
which is 4/3 as long. A hard target reads the same in both, fog 4/3 as much and smoother; the noise is alike
(``PHYSICS.md`` 10.5).

Let F(e; S) = Phi(z) be the distribution of a value, z that of a standard normal one of the same rank. A value e is
exceeded where the noise first crosses z(e, r) upwards. With lambda the mean square slope of the noise and w the slope
of z over its root, Rice's formula gives the rate of crossings at which none was before,

    sqrt(lambda) M(z) [h(w) + max(-w, 0)],   M(z) = phi(z) / Phi(z),   h(w) = phi(w) - |w| (1 - Phi(|w|)),

and the second term, of a waveform that rises through e by itself, integrates to -ln F, so that

    P(largest before R <= e) = exp(-Lambda(e, R)),   Lambda(e, R) = -ln F(e; max S) + sqrt(lambda) int_0^R M h(w) dr.

So the strongest return of fog is drawn from a table of Lambda just as the strongest particle is. The largest value lies
where the noise has the slope of z: at r with a density that goes as phi(w) dM/de.

References:
    PHYSICS.md 5.3 (photons), 5.8 (waveform). Rice 1945, Bell Syst. Tech. J. 24; Cramer and Leadbetter 1967, Stationary
    and Related Stochastic Processes, 13.2 (crossings of a curve).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtri_exp
from torch import Tensor, nn

from torchweather.atmosphere.density_field import BanksAlongBeams, of_beams
from torchweather.atmosphere.fog_optics import FogOptics, mor_range_m
from torchweather.atmosphere.weather import Fog
from torchweather.core.errors import check_one_of
from torchweather.core.random import Variate
from torchweather.lidar.beam import Beam, RangeGrid
from torchweather.lidar.returns.strongest import expected_number, table_at
from torchweather.lidar.sensor import Lidar
from torchweather.pipeline.module_copy import with_buffers

__all__ = ["SoftReturn"]

BACKSCATTERS = ("mie", "hahner")
RECEIVERS = ("gate", "matched")
HAHNER_BETA_MOR_PER_SR = 0.046  # Rasshofer 2011, Hahner 2021: beta = 0.046 / MOR, a lidar ratio of 65 sr
PULSE_NODES = 16  # of each of two parts
COUNT_NODES = 129  # cells by powers of two: the search in strongest.py halves them
FEWEST_PHOTONS = 0.1  # of those at the threshold: a reading below it is not drawn
PHOTON_LOW, PHOTON_HIGH, PHOTON_NODES = 1e-2, 1e5, 2048
NEVER = 1e-30  # -ln F of a reading that never occurs, so that logarithms stay finite
NO_PHOTONS = 1e-20

# Mean square slope of white noise filtered with sin^2(pi r / 2 l), over its variance, times l^2.
SLOPE_SQUARE = math.pi**2 / 3.0
# Weight of "where the waveform rises" among the places, for a reach so short that its noise decides nothing.
RISING = 1e-3
# Largest value of a fog's waveform, by fog without its visibility, sensor, backscatter and receiver.
_MOST: dict[tuple[Fog, Lidar, str, str], float] = {}
# What does not depend on the weather of a waveform, by receiver, grid and beam.
_LIGHT: dict[tuple[str | float, ...], tuple[NDArray[np.float32], ...]] = {}
KEPT = 64


@lru_cache(maxsize=8)
def _count_tables(roots: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """ln(-ln F) and ln M at the nodes, ``(COUNT_NODES, PHOTON_NODES)`` each, over the ln of the expected photons.

    ``F(n; mu) = Q(n + 1/2, mu)``: the Poisson distribution continued between the integers with the mean kept.
    """
    reading = torch.linspace(roots[0], roots[1], COUNT_NODES, dtype=torch.float64)[:, None] ** 2 + 0.5
    mean = torch.logspace(math.log10(PHOTON_LOW), math.log10(PHOTON_HIGH), PHOTON_NODES, dtype=torch.float64)
    above, below = torch.special.gammainc(reading, mean), torch.special.gammaincc(reading, mean)
    # Far in the tail, where Q underflows: Q(a, mu) = mu^(a-1) exp(-mu) / Gamma(a).
    far = mean - (reading - 1) * mean.log() + torch.lgamma(reading)
    minus_log = torch.where(above < 0.5, -torch.log1p(-above.clamp_max(0.5)), -below.clamp_min(1e-280).log())
    minus_log = torch.where(below < 1e-270, far, minus_log).clamp_min(NEVER)
    rank = torch.from_numpy(ndtri_exp(-minus_log.numpy()))
    log_mills = -0.5 * rank.square() - 0.5 * math.log(2.0 * math.pi) - torch.special.log_ndtr(rank)
    return minus_log.log().float(), log_mills.float()


class SoftReturn(nn.Module):
    """The return of fog in a LiDAR's beams, one a beam; used by ``ParticleReturns``.

    Args:
        weather: the fog.
        sensor: the LiDAR.
        backscatter: ``mie`` (Mie theory over the fog's own distribution at the laser's wavelength) or ``hahner``
            (0.046 / MOR, with the visible MOR).
        receiver: ``gate`` or ``matched``.
    """

    mor_m: Tensor
    never_table: Tensor
    mills_table: Tensor
    pulse_length_m: Tensor
    photons_at_threshold: Tensor
    pulse_place: Tensor
    pulse_weight: Tensor

    echoes = 1
    kind = "fog"

    def __init__(self, weather: Fog, sensor: Lidar, *, backscatter: str = "mie", receiver: str = "gate") -> None:
        super().__init__()
        check_one_of("fog_backscatter", backscatter, BACKSCATTERS, owner=self)
        check_one_of("receiver", receiver, RECEIVERS, owner=self)
        self.weather, self.backscatter, self.receiver = weather, backscatter, receiver
        self.grid = RangeGrid.of(sensor)
        self.optics = FogOptics(weather, float(sensor.wavelength_nm))
        place, weight = np.polynomial.legendre.leggauss(PULSE_NODES)
        for name, value in (
            ("mor_m", weather.mor_m),
            ("pulse_length_m", sensor.pulse_length_m),
            ("photons_at_threshold", sensor.photons_at_threshold),
        ):
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.register_buffer("pulse_place", torch.from_numpy(place).float(), persistent=False)
        self.register_buffer("pulse_weight", torch.from_numpy(weight).float(), persistent=False)
        self._set_readings(sensor)

    def at_intensity(self, weather: Fog, beam: Beam) -> SoftReturn:
        """The same for a fog that differs by its visibility alone; tables are shared.

        Args:
            weather: the fog.
            beam: of particles that are counted; not looked at.
        """
        found = with_buffers(self, mor_m=torch.as_tensor(weather.mor_m, dtype=torch.float32))
        found.weather = weather
        return found

    def _set_readings(self, sensor: Lidar) -> None:
        """Nodes of the reading, uniform in its square root, which has the same photon noise everywhere."""
        photons = sensor.photons_at_threshold
        brightest = self._most(sensor) * photons
        self.root_low = math.sqrt(FEWEST_PHOTONS * photons)
        self.root_high = max(math.sqrt(brightest) + 3.0, 2.0 * math.sqrt(photons) + 3.0)
        self.root_step = (self.root_high - self.root_low) / (COUNT_NODES - 1)
        never, mills = _count_tables((self.root_low, self.root_high))
        self.register_buffer("never_table", never, persistent=False)
        self.register_buffer("mills_table", mills, persistent=False)

    def _most(self, sensor: Lidar) -> float:
        """Largest expected value of any visibility over the threshold."""
        known = (replace(self.weather, mor_m=math.inf), sensor, self.backscatter, self.receiver)
        if known not in _MOST:
            with torch.no_grad():
                low, high = mor_range_m(self.weather)
                mor_m = torch.logspace(math.log10(low), math.log10(high), 32)
                beam = Beam(sensor)
                # Extinction at its least, the geometric optics of Koschmieder's law.
                most = self._waveform(beam, mor_m, 2.9 / mor_m, self.grid.quadrature_m)[0].max() / beam.threshold
            if len(_MOST) >= KEPT:
                _MOST.clear()
            _MOST[known] = float(most)
        return _MOST[known]

    def backscatter_per_m_sr(self, mor_m: Tensor) -> Tensor:
        """beta, 1/(m sr), of the shape of ``mor_m``."""
        if self.backscatter == "hahner":
            return HAHNER_BETA_MOR_PER_SR / mor_m
        return self.optics.backscatter_per_m_sr(mor_m)

    def signal(self, beam: Beam, extinction_per_m: Tensor, range_m: Tensor) -> Tensor:
        """Expected soft return S over the system constant, ``(B, ...)``, at ranges ``(...)``, 1/(m^2 sr)."""
        return self._waveform(beam, self.mor_m.reshape(-1), extinction_per_m, range_m)[0]

    def _waveform(
        self,
        beam: Beam,
        mor_m: Tensor,
        extinction_per_m: Tensor,
        range_m: Tensor,
        air: BanksAlongBeams | None = None,
    ) -> tuple[Tensor, Tensor]:
        """S and its change per metre: the pulse begins and ends with nothing, so that only its shape moves."""
        source_m, pulse, changing = self._sources(beam, range_m)
        extinction = extinction_per_m.reshape(-1, *([1] * source_m.ndim))
        way_m = source_m if air is None else air.way_m(source_m)
        response = beam.particle_response(source_m) / source_m.square() * torch.exp(-2.0 * extinction * way_m)
        if air is not None:
            response = response * air.density_at(source_m)
        beta = self.backscatter_per_m_sr(mor_m).reshape(-1, *([1] * range_m.ndim)) * self.pulse_length_m
        return beta * (response * pulse).sum(-1), beta * (response * changing).sum(-1)

    def _sources(self, beam: Beam, range_m: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Places where a value's light comes from, their weights and the change of those, ``(..., 2 PULSE_NODES)``."""
        # Where in the fog the light comes from, (..., 2 PULSE_NODES): the part of the pulse that meets the rising
        # response and that which meets the full one. f is smooth in each: S has no ripples however short the rise.
        reach_m = self.pulse_length_m * (2.0 if self.receiver == "matched" else 1.0)
        behind_m = range_m + reach_m
        begin_m = torch.maximum(range_m - reach_m, beam.near_start_m).clamp_min(1e-3)
        begin_m = torch.minimum(begin_m, behind_m)
        full_m = torch.minimum(torch.maximum(beam.near_full_m, begin_m), behind_m)
        place = 0.5 * (1.0 + self.pulse_place)
        lengths_m = torch.stack([full_m - begin_m, behind_m - full_m], -1)[..., None]
        source_m = torch.stack([begin_m, full_m], -1)[..., None] + lengths_m * place
        weight = 0.5 * self.pulse_weight * lengths_m / self.pulse_length_m
        phase = (range_m[..., None, None] - source_m) * (math.pi / self.pulse_length_m)
        shape, steepness = self._pulse(phase)
        changing = weight * steepness / self.pulse_length_m
        return source_m.flatten(-2), (weight * shape).flatten(-2), changing.flatten(-2)

    def _pulse(self, phase: Tensor) -> tuple[Tensor, Tensor]:
        """Share of a hard target's peak that light from another place adds, and its change per pulse length.

        Args:
            phase: distance between the places times pi over the pulse length.
        """
        if self.receiver == "gate":
            return 0.5 + 0.5 * phase.cos(), -0.5 * math.pi * phase.sin()
        away = phase.abs()  # to 2 pi, where two pulses no longer meet
        left = 1.0 - away / (2.0 * math.pi)
        shape = left * (2.0 + away.cos()) / 3.0 + away.sin() / (2.0 * math.pi)
        return shape, -phase.sign() * ((1.0 - away.cos()) / 3.0 + (math.pi / 3.0) * left * away.sin())

    def between(
        self,
        beam: Beam,
        extinction_per_m: Tensor,
        density_scale: Tensor | None = None,
        air: BanksAlongBeams | None = None,
        sizes: Tensor | None = None,
    ) -> Tensor:
        """Lambda from one node of the reading to the next up to each node of range, ``(B, E, P)``.

        Args:
            beam: the sensor's.
            extinction_per_m: ``(B,)`` of all weather together.
            density_scale: ``(B,)`` droplets over those of the visibility; ``None`` is 1.
            air: patches along each of the B beams; ``None`` is the same everywhere.
            sizes: of particles that are seen one by one; droplets are not.
        """
        return self.tables(beam, extinction_per_m, density_scale, air)[0]

    def tables(
        self,
        beam: Beam,
        extinction_per_m: Tensor,
        density_scale: Tensor | None = None,
        air: BanksAlongBeams | None = None,
        sizes: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Lambda as ``between``, and the weight of the places up to each node of range, of its shape.

        The weight is that of a reading between two nodes. Arguments as of ``between``.
        """
        photons, slope = self._photons(beam, extinction_per_m, density_scale, air)
        risen, mills = self._risen(photons), self._read(self.mills_table, photons)
        chance, alike = self._crossings(slope)
        per_m = mills * chance[:, None]
        crossed = self.grid.integrated(_apart(per_m)) * (math.sqrt(SLOPE_SQUARE) / self.pulse_length_m)
        weight = self.grid.integrated(_apart(mills * alike[:, None]))
        return risen + crossed, weight + RISING * risen

    def compiled_tables(self, beam: Beam, extinction_per_m: Tensor) -> tuple[Tensor, Tensor]:
        """As ``tables`` in air without effects, by compiled loops; to rounding.

        Args:
            beam: the sensor's.
            extinction_per_m: ``(B,)`` of all weather together.
        """
        from torchweather.lidar.returns.compiled_fog import Readings, count_readings, light_of_fog

        response, source_m, pulse, changing = self._light_of(beam)
        readings = Readings(*_by_photons(self.root_low, self.root_high))
        batch, shape = len(extinction_per_m), self.grid.quadrature_m.shape
        light, per_m = torch.empty(batch, *shape), torch.empty(batch, *shape)
        for sample, extinction in enumerate(extinction_per_m.tolist()):
            own, own_per_m = light[sample].reshape(-1).numpy(), per_m[sample].reshape(-1).numpy()
            light_of_fog(own, own_per_m, response, source_m, pulse, changing, np.float32(extinction))
        beta = self.backscatter_per_m_sr(self.mor_m.reshape(-1)).reshape(-1, 1, 1) * self.pulse_length_m
        photons, slope = self._of_light(beta * light, beta * per_m, beam.threshold)
        chance, alike = self._crossings(slope)
        position, largest = _place_of(photons), _place_of(self._largest(photons))
        between, weight = (torch.empty(batch, COUNT_NODES, self.grid.nodes) for _ in range(2))
        scale = np.float32(math.sqrt(SLOPE_SQUARE) / float(self.pulse_length_m))
        width_m = self.grid.quadrature_width_m.numpy()
        for sample in range(batch):
            count_readings(
                between[sample].numpy(),
                weight[sample].numpy(),
                position[sample].contiguous().numpy(),
                largest[sample].contiguous().numpy(),
                chance[sample].contiguous().numpy(),
                alike[sample].contiguous().numpy(),
                width_m,
                readings,
                scale,
                np.float32(RISING),
            )
        return between, weight

    def _light_of(self, beam: Beam) -> tuple[NDArray[np.float32], ...]:
        """Response, places, weights and their change at the nodes of the quadrature, as compiled loops take them.

        They do not depend on the weather, and are kept.
        """
        numbers = [value for one in (self.pulse_length_m, *beam.buffers()) for value in one.reshape(-1).tolist()]
        known = (self.receiver, self.grid.near_m, self.grid.far_m, self.grid.scale_m, *numbers)
        if known not in _LIGHT:
            source_m, pulse, changing = self._sources(beam, self.grid.quadrature_m)
            response = beam.particle_response(source_m) / source_m.square()
            if len(_LIGHT) >= KEPT:
                _LIGHT.clear()
            arrays = [one.reshape(-1, one.shape[-1]).contiguous() for one in (response, source_m, pulse, changing)]
            _LIGHT[known] = tuple(one.numpy() for one in arrays)
        return _LIGHT[known]

    def _photons(
        self, beam: Beam, extinction_per_m: Tensor, density_scale: Tensor | None, air: BanksAlongBeams | None
    ) -> tuple[Tensor, Tensor]:
        """Expected photons of a value at the nodes of the quadrature, and w there, ``(B, cells, G)`` each.

        dz/dr is that of -2 sqrt(photons), whose noise is of 1 everywhere.
        """
        mor_m = self.mor_m.reshape(-1)
        if air is not None:
            mor_m = of_beams(mor_m, extinction_per_m.shape[0])
        signal, per_m = self._waveform(beam, mor_m, extinction_per_m, self.grid.quadrature_m, air)
        return self._of_light(signal, per_m, beam.threshold, density_scale)

    def _of_light(
        self, signal: Tensor, per_m: Tensor, threshold: Tensor, density_scale: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """As ``_photons``, of the signals and their change per metre."""
        scale = self.photons_at_threshold / threshold
        if density_scale is not None:
            scale = scale * density_scale.to(signal)[:, None, None]
        photons = (signal * scale).clamp_min(NO_PHOTONS)
        return photons, per_m * scale / photons.sqrt() * (-self.pulse_length_m / math.sqrt(SLOPE_SQUARE))

    def _crossings(self, slope: Tensor) -> tuple[Tensor, Tensor]:
        """h(w) of crossings, and phi(w) over its largest, of the shape of w."""
        steep = slope.abs()
        chance = torch.exp(-0.5 * steep.square()) / math.sqrt(2.0 * math.pi) - steep * torch.special.ndtr(-steep)
        return chance.clamp_min(0.0), torch.exp(-0.5 * slope.square())

    def _risen(self, photons: Tensor) -> Tensor:
        """-ln F of the largest expected value, from one node of the reading to the next, up to each node of range."""
        never = _apart(self._read(self.never_table, self._largest(photons)))
        return torch.cat([torch.zeros_like(never[..., :1]), never], -1)

    def _largest(self, photons: Tensor) -> Tensor:
        """Largest expected value up to the end of each cell, ``(B, cells)``."""
        flat = photons.flatten(1)
        # The waveform rises once and falls once.
        peak = flat.detach().argmax(1, keepdim=True)
        behind = torch.arange(flat.shape[1], device=flat.device) > peak
        return torch.where(behind, flat.gather(1, peak), flat).reshape(photons.shape)[..., -1]

    def _read(self, table: Tensor, photons: Tensor) -> Tensor:
        """Exponential of a table at the nodes of the reading and at expected photons ``(B, ...)``: ``(B, E, ...)``."""
        position = _place_of(photons)
        node = position.detach().floor().clamp(0, PHOTON_NODES - 2).to(torch.int64)
        flat = node.reshape(-1)
        table = table.to(position.dtype)
        # Below the table both are powers of the mean: the first cell goes on.
        found = torch.lerp(table[:, flat], table[:, flat + 1], (position - node).reshape(-1))
        return torch.exp(found).reshape(COUNT_NODES, *photons.shape).transpose(0, 1)

    def expected_above(self, beam: Beam, signal: Tensor, extinction_per_m: Tensor, reach_m: Tensor) -> Tensor:
        """Lambda(e, R) with ``exp(-Lambda)`` the probability that no reading exceeds ``signal``, ``(B, N)``."""
        row = self._row(beam, signal)
        return expected_number(self.between(beam, extinction_per_m), row, self.grid.position(reach_m))

    def chance_before(
        self, beam: Beam, signal: Tensor, extinction_per_m: Tensor, apart_m: float, reach_m: Tensor
    ) -> Tensor:
        """Probability of a reading above ``signal`` that lies ``apart_m`` or more before ``reach_m``.

        ``(B, N)``; summed over the readings between two nodes, for a reach at each node of range.
        """
        between, places = self.tables(beam, extinction_per_m)
        above = between.flip(1).cumsum(1).flip(1)  # (B, E, P)
        none = torch.exp(-above)
        read = torch.cat([none[:, 1:], torch.ones_like(none[:, :1])], 1) - none
        reach = torch.arange(self.grid.nodes).to(places)
        near = self.grid.position((self.grid.range_m(reach) - apart_m).clamp_min(self.grid.near_m))
        node = near.floor().clamp_max(self.grid.nodes - 2).to(torch.int64)
        before = torch.lerp(places[..., node], places[..., node + 1], near - node)
        chance = (read * before / places.clamp_min(NEVER)).flip(1).cumsum(1).flip(1)
        return table_at(chance, self._row(beam, signal), self.grid.position(reach_m))

    def _row(self, beam: Beam, signal: Tensor) -> Tensor:
        """Place of a signal on the axis of readings."""
        photons = (signal / beam.threshold * self.photons_at_threshold).clamp_min(1e-12)
        return ((torch.sqrt(photons) - self.root_low) / self.root_step).clamp(0.0, COUNT_NODES - 1)

    def start(self, reach_m: Tensor) -> Tensor | None:
        """Place on the grid where the fog begins; ``None`` is its first node."""
        return None

    def signal_at(self, row: Tensor, beam: Beam) -> Tensor:
        """Signal at a place on the axis of readings."""
        photons = (self.root_low + self.root_step * row).square()
        return photons * (beam.threshold / self.photons_at_threshold)

    def parameters_of_table(self) -> tuple[Tensor, ...]:
        """Parameters of ``between`` besides the beam and the extinction, as far as it can change."""
        return self.mor_m, self.pulse_length_m, self.photons_at_threshold

    def variates(self) -> tuple[Variate, ...]:
        """Arrival and place of the strongest reading of each beam."""
        return Variate("fog_arrival", "uniform", (1, "N")), Variate("fog_place", "uniform", (1, "N"))


def _place_of(photons: Tensor) -> Tensor:
    """Place of expected photons on the nodes of the tables."""
    step = math.log(PHOTON_HIGH / PHOTON_LOW) / (PHOTON_NODES - 1)
    return (photons.log() - math.log(PHOTON_LOW)) / step


@lru_cache(maxsize=8)
def _by_photons(*roots: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The tables of counts with the photons first, which compiled loops read row by row."""
    never, mills = (table.T.contiguous().numpy() for table in _count_tables(roots))
    return never, mills


def _apart(at: Tensor) -> Tensor:
    """Shares between one node of the reading and the next, dimension 1; the last: above it."""
    return (at - torch.cat([at[:, 1:], torch.zeros_like(at[:, :1])], 1)).clamp_min(0.0)
