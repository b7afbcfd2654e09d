"""BeamParticles: how many drops or flakes of a beam return more than a given signal, as a function of range.

``Lambda(e, R) = int A_b(r) N_>(D_e(r)) dr`` up to R. A particle of diameter D at range r returns, over the system
constant, ``g(r) min(1, (D / D_b(r))^2)``, where g is the signal of one that fills the beam. To it adds what the smaller
particles within the same pulse return on average, ``g(r) (pi/4) l int_0^D N D'^2 dD'``, D up to that of the beam: a
pulse of the shape sin^2 and the length l = c tau / 2 adds echoes over l (``PHYSICS.md`` 10.4). ``D_e(r)`` is the
diameter whose particle returns e with the others of its pulse, and N_> the number of larger particles per m^3.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor, nn

from torchweather.atmosphere.density_field import BanksAlongBeams, of_beams
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.core.compiled import uses_compiled
from torchweather.core.errors import InputValueError, check_one_of, check_positive
from torchweather.core.random import Variate
from torchweather.lidar.beam import Beam, RangeGrid
from torchweather.lidar.returns.strongest import NOTHING, expected_number, last_below
from torchweather.lidar.sensor import Lidar
from torchweather.physics import (
    InterpolationTable,
    axial_q_back,
    melted_diameter_mm,
    rain_q_back,
    water_refractive_index,
)
from torchweather.pipeline.module_copy import with_buffers
from torchweather.pipeline.tiling import is_exporting

__all__ = ["SIZE_KNOTS_MM", "BeamParticles", "RATE_HIGH_MM_PER_H", "RATE_LOW_MM_PER_H", "RATE_NODES"]

RATE_LOW_MM_PER_H, RATE_HIGH_MM_PER_H, RATE_NODES = 1e-3, 300.0, 64
DIAMETER_NODES = 512
SIGNAL_NODES = 65  # cells by powers of two: the search in strongest.py halves them
FAINTEST = 1e-3  # of the threshold: particles below it are not drawn
SMALLEST_MM = 1e-2  # measured bins may begin at 0; below this nothing is seen
BRIGHTER = 4.0  # the brightest particle with the others of its pulse over itself, at most
FEW_PER_M3 = 1e-9  # number that counts as none: a beam holds 10 m^3 at most
SIZE_KNOTS_MM = (1.0, 2.0, 4.0, 8.0)  # outlines at which the number of particles may be another (``between``)
SHARE_MORE = 1e-4  # probability that a beam holds more visible particles than are drawn
MOST_PARTICLES = 64
# D3.4 as published (PHYSICS.md 5, 8): a cylinder of radius 4.75 mm, drops of 0.5-6 mm, evenly from 10 % of the object's
# range to it, seen where D > 0.584 mm x R[m] (what 10 fs and 3.28 photons mean together).
PUBLISHED_RADIUS_M = 4.75e-3
PUBLISHED_DOMAIN_MM = (0.5, 6.0)
PUBLISHED_START = 0.1
PUBLISHED_SEEN_M_PER_M = 0.584e-3


@dataclass(frozen=True)
class _Counted:
    """Particles of a weather by their outline: its diameters, and N_> over ln(diameter) as a function of the rate."""

    smallest_m: float
    largest_m: float
    tail: InterpolationTable


@lru_cache(maxsize=64)
@torch.inference_mode(False)  # for a call with gradients, too
def _counted(weather: Rain | Snow, published: bool) -> _Counted:
    """Counted particles of a weather, whose own rate counts for nothing."""
    some = weather.distribution(torch.tensor([RATE_LOW_MM_PER_H, RATE_HIGH_MM_PER_H]))
    counted_low = max(some.diameter_min_mm, SMALLEST_MM)
    counted_high = min(some.diameter_max_mm, some.span_mm()[1])
    if published:
        counted_low, counted_high = PUBLISHED_DOMAIN_MM
    ends = weather.physical_diameter_mm(torch.tensor([counted_low, counted_high], dtype=torch.float64))
    smallest_m, largest_m = (float(end) * 1e-3 for end in ends)
    steps = torch.arange(DIAMETER_NODES, dtype=torch.float64) / (DIAMETER_NODES - 1)
    outline = 1e3 * smallest_m * torch.exp(steps * math.log(largest_m / smallest_m))
    counted = melted_diameter_mm(outline) if weather.particle == "melted-flake" else outline

    def tail(rate: Tensor) -> Tensor:
        distribution = weather.distribution(rate)
        whole = distribution.tail_per_m3(counted)
        return (whole - distribution.tail_per_m3(counted[-1:])).clamp_min(0.0) + FEW_PER_M3

    table = InterpolationTable(tail, RATE_LOW_MM_PER_H, RATE_HIGH_MM_PER_H, RATE_NODES, zero_at_zero=True)
    return _Counted(smallest_m, largest_m, table)


class BeamParticles(nn.Module):
    """Rain drops or snow flakes in a LiDAR's beams; used by ``ParticleReturns``.

    Args:
        weather: the precipitation.
        sensor: the LiDAR.
        q_back: backscatter efficiency of a particle; ``None`` is 0.2 for drops (0.06 at 1550 nm) and a Lambertian disk
            of the flake's reflectivity at the laser's wavelength; ``"glints"`` the lower bound for drops, front and
            rear glint of 1 mm spheres.
        published: D3.4's beam, drops and detection limit.
    """

    rate_mm_per_h: Tensor
    q_back: Tensor

    def __init__(self, weather: Rain | Snow, sensor: Lidar, *, q_back: float | str | None, published: bool) -> None:
        super().__init__()
        self.weather, self.kind, self.published = weather, weather.kind, published
        self.grid = (
            RangeGrid(1e-3, sensor.max_range_m, 1.0)  # D3.4 knows no near-range response
            if published
            else RangeGrid.of(sensor)
        )
        self.register_buffer("rate_mm_per_h", torch.as_tensor(weather.rate_mm_per_h, dtype=torch.float32))
        self.register_buffer("q_back", torch.tensor(_q_back(weather, sensor, q_back), dtype=torch.float32))
        self.pulse_length_m = 0.0 if published else sensor.pulse_length_m
        counted = _counted(replace(weather, rate_mm_per_h=0.0), published)
        self.smallest_m, self.largest_m = counted.smallest_m, counted.largest_m
        self.tail = copy.deepcopy(counted.tail)
        self._set_signals(sensor)
        self.is_strongest = sensor.return_mode == "strongest"
        self.echoes = 1 if self.is_strongest else self._echoes(Beam(sensor))

    def at_intensity(self, weather: Rain | Snow, beam: Beam) -> BeamParticles:
        """The same for a weather that differs by its rate alone; tables are shared.

        Args:
            weather: of the kind.
            beam: the sensor's.
        """
        found = with_buffers(self, rate_mm_per_h=torch.as_tensor(weather.rate_mm_per_h, dtype=torch.float32))
        found.weather = weather
        if not self.is_strongest:
            found.echoes = found._echoes(beam)
        return found

    def _set_signals(self, sensor: Lidar) -> None:
        """Nodes of the signal, uniform in its logarithm, from far below the threshold to the brightest particle."""
        with torch.no_grad():
            full, diameter_m, _ = self._seen(Beam(sensor), torch.zeros(1))
            brightest = float((full * (self.largest_m / diameter_m).clamp_max(1.0) ** 2).max())
        threshold = sensor.threshold_per_m2_sr
        self.log_low = math.log(FAINTEST * threshold)
        self.log_step = (math.log(BRIGHTER * max(brightest, threshold)) - self.log_low) / (SIGNAL_NODES - 1)

    def _seen(
        self, beam: Beam, extinction_per_m: Tensor, air: BanksAlongBeams | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Signal of a particle that fills the beam ``(B, cells, G)``; the beam's diameter, area ``(1 or B, ...)``."""
        range_m = self.grid.quadrature_m
        clear = torch.exp(-2.0 * extinction_per_m[:, None, None] * (range_m if air is None else air.way_m(range_m)))
        if self.published:
            # A drop as wide as the beam; the same law D^2 / R^2, fixed at the published limit.
            diameter_m = torch.full_like(range_m, 2.0 * PUBLISHED_RADIUS_M)
            full = beam.threshold * (diameter_m / (PUBLISHED_SEEN_M_PER_M * range_m)).square()
            full = full.expand(extinction_per_m.shape[0], *range_m.shape)
            area = 0.25 * math.pi * diameter_m.square() / (1.0 - PUBLISHED_START)
            return full, diameter_m[None], area[None]
        brightness_per_sr = self.q_back / (4.0 * math.pi)
        full = brightness_per_sr * beam.particle_response(range_m) * clear / range_m.square()
        shape = (-1, *range_m.shape)
        return full, beam.diameter_m(range_m).reshape(shape), beam.area_m2(range_m).reshape(shape)

    def between(
        self,
        beam: Beam,
        extinction_per_m: Tensor,
        density_scale: Tensor | None = None,
        air: BanksAlongBeams | None = None,
        sizes: Tensor | None = None,
    ) -> Tensor:
        """Expected number of particles from one node of the signal to the next up to each node of range, ``(B, E, P)``.

        Args:
            beam: the sensor's.
            extinction_per_m: ``(B,)`` of all weather together.
            density_scale: ``(B,)`` particles over those of the rate; ``None`` is 1.
            air: patches along each of the B beams; ``None`` is the same everywhere.
            sizes: ``(B, knots)`` number of particles at ``SIZE_KNOTS_MM`` over that of the rate; ``None`` is 1.
        """
        per_m = self._per_m(beam, extinction_per_m, torch.arange(SIGNAL_NODES), density_scale, air, sizes)
        next_per_m = torch.cat([per_m[:, 1:], torch.zeros_like(per_m[:, :1])], 1)
        return self.grid.integrated((per_m - next_per_m).clamp_min(0.0))

    def compiled_between(
        self,
        beam: Beam,
        extinction_per_m: Tensor,
        density_scale: Tensor | None = None,
        sizes: Tensor | None = None,
        nodes: Tensor | None = None,
    ) -> Tensor:
        """As ``between`` in air without patches, by compiled loops; to rounding.

        Args:
            beam, extinction_per_m, density_scale, sizes: as of ``between``.
            nodes: some nodes of the signal, in order; ``None`` is all of them.
        """
        from torchweather.lidar.returns.compiled_table import Air, Sizes, count_between

        single = [values.float() for values in self._seen(beam, extinction_per_m)]
        full, diameter_m, area_m2 = (values.expand(len(extinction_per_m), -1, -1).contiguous() for values in single)
        tails = self._tails_in(len(extinction_per_m), density_scale, sizes).float().contiguous().numpy()
        nodes = torch.arange(SIGNAL_NODES) if nodes is None else nodes
        signal = torch.exp(self.log_low + self.log_step * nodes).numpy()
        log_step = math.log(self.largest_m / self.smallest_m) / (DIAMETER_NODES - 1)
        of_diameters = [np.float32(one) for one in (self.smallest_m, log_step, 0.25 * math.pi * self.pulse_length_m)]
        between = torch.empty(len(extinction_per_m), len(nodes), self.grid.nodes)
        width_m = self.grid.quadrature_width_m.numpy()
        for sample, own in enumerate(between):
            air = Air(full[sample].numpy(), diameter_m[sample].numpy(), area_m2[sample].numpy(), width_m)
            count_between(own.numpy(), air, Sizes(tails[sample], *of_diameters), signal)
        return between

    def _per_m(
        self,
        beam: Beam,
        extinction_per_m: Tensor,
        nodes: Tensor,
        density_scale: Tensor | None = None,
        air: BanksAlongBeams | None = None,
        sizes: Tensor | None = None,
    ) -> Tensor:
        """Expected number of particles a metre above some nodes of the signal, ``(B, nodes, cells, G)``.

        Arguments as of ``between``.
        """
        batch = extinction_per_m.shape[0]
        full, diameter_m, area_m2 = self._seen(beam, extinction_per_m, air)
        signal = torch.exp(self.log_low + self.log_step * nodes.to(full.device))
        ratio = signal[:, None, None] / full.clamp_min(1e-30)[:, None]  # (B, E, cells, G): share of the full beam
        tails = self._tails_in(batch, density_scale, sizes)
        density = None if air is None else air.density_at(self.grid.quadrature_m)
        position, seen = self._needed(ratio, diameter_m, tails, density)
        node = position.detach().floor().clamp_max(DIAMETER_NODES - 2).to(torch.int64)
        flat = node.flatten(1)
        per_m3 = torch.lerp(tails.gather(1, flat), tails.gather(1, flat + 1), (position - node).flatten(1))
        per_m = torch.where(seen, per_m3.reshape(ratio.shape), torch.zeros_like(ratio)) * area_m2[:, None]
        if density is not None:
            per_m = per_m * density[:, None]
        return per_m

    def _needed(self, ratio: Tensor, beam_m: Tensor, tails: Tensor, density: Tensor | None) -> tuple[Tensor, Tensor]:
        """Place on the nodes of the diameter from which on a particle returns a share of the full beam's signal.

        Args:
            ratio: ``(B, E, cells, G)`` the share.
            beam_m: ``(1 or B, cells, G)`` diameter of the beam.
            tails: ``(B, D)`` N_> at the nodes.
            density: ``(B, cells, G)`` of the air over its mean; ``None`` is 1.

        Returns:
            The place, and whether any particle returns that much, of the shape of ``ratio``.
        """
        log_step = math.log(self.largest_m / self.smallest_m) / (DIAMETER_NODES - 1)
        if self.pulse_length_m == 0.0:
            log_diameter = 0.5 * torch.log(ratio) + torch.log(beam_m)[:, None]
            position = ((log_diameter - math.log(self.smallest_m)) / log_step).clamp(0.0, DIAMETER_NODES - 1.0)
            return position, ratio < 1.0
        node = torch.arange(DIAMETER_NODES, device=tails.device).to(tails)
        outline_m = self.smallest_m * torch.exp(log_step * node)
        # Squared diameters of all smaller particles, per m^3, at the nodes.
        middle_square = (self.smallest_m * torch.exp(log_step * (node[:-1] + 0.5))).square()
        smaller = torch.nn.functional.pad(((tails[:, :-1] - tails[:, 1:]) * middle_square).cumsum(1), (1, 0))
        others = 0.25 * math.pi * self.pulse_length_m * smaller[:, None]  # (B, 1, D)
        beam_of = beam_m.flatten(1)[..., None]  # (1 or B, places, 1)
        # What fills the beam returns no more, nor do the others of it: both are held from there on.
        filling = (torch.log(beam_of / self.smallest_m) / log_step).clamp(0.0, DIAMETER_NODES - 1.0).to(torch.int64)
        held = others.expand(-1, filling.shape[1], -1).gather(2, filling.expand(others.shape[0], -1, -1))
        others = torch.minimum(others, held)
        if density is not None:
            others = others * density.flatten(1)[..., None]
        # Rising over D; in place, as fresh memory for 400,000 numbers costs more than the arithmetic on them.
        square = (outline_m / beam_of).clamp_max_(1.0).square_()
        share = others.add_(square).expand(ratio.shape[0], -1, -1)
        wanted = ratio.flatten(2).transpose(1, 2).contiguous()  # (B, places, E)
        if is_exporting():
            found = last_below(
                lambda at: share.gather(2, at) <= wanted, torch.zeros_like(wanted).long(), DIAMETER_NODES - 1
            )
        else:
            found = torch.searchsorted(share.detach().contiguous(), wanted.detach(), right=True) - 1
            found = found.clamp(0, DIAMETER_NODES - 2)
        low, high = share.gather(2, found), share.gather(2, found + 1)
        # The share goes with the square of the diameter, whose logarithm the nodes are.
        rise = torch.log(high / low).clamp_min(1e-12)
        position = found + (torch.log(wanted / low) / rise).clamp(0.0, 1.0)
        seen = wanted < share[..., -1:]
        return position.transpose(1, 2).reshape(ratio.shape), seen.transpose(1, 2).reshape(ratio.shape)

    def outline_m(
        self,
        beam: Beam,
        range_m: Tensor,
        signal: Tensor,
        extinction_per_m: Tensor,
        density_scale: Tensor | None = None,
    ) -> Tensor:
        """Outline's diameter, m, of the particle that returns a signal with the others of its pulse, ``(B, N)``.

        The inverse of what ``between`` counts, to a node of the diameter (about 1 %). Of what fills the beam it is the
        diameter of the beam. Banks of weather are left out of the way to the particle.

        Args:
            beam: the sensor's.
            range_m, signal: ``(B, N)`` of the particles; 0 where there is none, which gives the smallest.
            extinction_per_m: ``(B,)`` of all weather together.
            density_scale: ``(B,)`` particles over those of the rate; ``None`` is 1.
        """
        far_m = range_m.clamp_min(self.grid.near_m)
        if self.published:
            beam_m = torch.full_like(far_m, 2.0 * PUBLISHED_RADIUS_M)
            full = beam.threshold * (beam_m / (PUBLISHED_SEEN_M_PER_M * far_m)).square()
        else:
            beam_m = beam.diameter_m(far_m[..., None])[..., 0]
            clear = torch.exp(-2.0 * extinction_per_m[:, None] * far_m)
            response = beam.particle_response(far_m, of_each_sample=True)
            full = self.q_back / (4.0 * math.pi) * response * clear / far_m.square()
        wanted = signal / full.clamp_min(1e-30)
        tails = self._tails(len(range_m)).to(wanted)
        if density_scale is not None:
            tails = tails * density_scale.to(tails)[:, None]
        log_step = math.log(self.largest_m / self.smallest_m) / (DIAMETER_NODES - 1)
        node = torch.arange(DIAMETER_NODES, device=tails.device).to(tails)
        middle_square = (self.smallest_m * torch.exp(log_step * (node[:-1] + 0.5))).square()
        smaller = torch.nn.functional.pad(((tails[:, :-1] - tails[:, 1:]) * middle_square).cumsum(1), (1, 0))
        others = 0.25 * math.pi * self.pulse_length_m * smaller  # (B, D)

        def returned(at: Tensor) -> Tensor:
            share = (self.smallest_m * torch.exp(log_step * at.to(tails)) / beam_m).clamp_max(1.0).square()
            return share + others.gather(1, at)

        found = last_below(lambda at: returned(at) <= wanted, torch.zeros_like(wanted).long(), DIAMETER_NODES - 1)
        return torch.minimum(self.smallest_m * torch.exp(log_step * (found + 0.5).to(tails)), beam_m)

    def fall_speed_m_per_s(self, outline_m: Tensor) -> Tensor:
        """Fall speed, m/s, of particles of an outline's diameter, m."""
        outline_mm = (1e3 * outline_m).double()
        counted = melted_diameter_mm(outline_mm) if self.weather.particle == "melted-flake" else outline_mm
        return self.weather.fall_speed_m_per_s(counted).to(outline_m)

    def _tails(self, batch: int) -> Tensor:
        """N_>, m^-3, at the nodes of diameter, ``(B, D)``."""
        tails: Tensor = self.tail(self.rate_mm_per_h.reshape(-1))
        return of_beams((tails - FEW_PER_M3).clamp_min(0.0), batch)

    def _tails_in(self, batch: int, density_scale: Tensor | None, sizes: Tensor | None) -> Tensor:
        """``_tails`` in the air of the effects; arguments as of ``between``."""
        tails = self._tails(batch)
        if sizes is not None:
            tails = self._of_sizes(tails, sizes.to(tails))
        return tails if density_scale is None else tails * density_scale.to(tails)[:, None]

    def _of_sizes(self, tails: Tensor, factors: Tensor) -> Tensor:
        """N_> ``(B, D)`` with the number of each size times a factor, linear in ln D between the knots ``(B, knots)``.

        A sample whose factors are all 1 keeps its bits.
        """
        step = math.log(self.largest_m / self.smallest_m) / (DIAMETER_NODES - 1)
        middle = math.log(1e3 * self.smallest_m) + step * (torch.arange(DIAMETER_NODES - 1, device=tails.device) + 0.5)
        place = ((middle.to(tails) - math.log(SIZE_KNOTS_MM[0])) / math.log(2.0)).clamp(0.0, len(SIZE_KNOTS_MM) - 1.0)
        knot = place.floor().clamp_max(len(SIZE_KNOTS_MM) - 2)
        low = knot.to(torch.int64)
        factor = torch.lerp(factors[:, low], factors[:, low + 1], place - knot)  # (B, D - 1)
        cells = (tails[:, :-1] - tails[:, 1:]) * factor
        more = torch.cat([cells.flip(1).cumsum(1).flip(1), torch.zeros_like(tails[:, :1])], 1) + tails[:, -1:]
        return torch.where((factors == 1.0).all(1, keepdim=True), tails + (more - more.detach()), more)

    def expected_above(self, beam: Beam, signal: Tensor, extinction_per_m: Tensor, reach_m: Tensor) -> Tensor:
        """Lambda(e, R): expected number of particles before ``reach_m`` above ``signal``, ``(B, N)``."""
        row = ((torch.log(signal.clamp_min(1e-30)) - self.log_low) / self.log_step).clamp(0.0, SIGNAL_NODES - 1)
        return expected_number(self.between(beam, extinction_per_m), row, self.grid.position(reach_m))

    def tables(
        self,
        beam: Beam,
        extinction_per_m: Tensor,
        density_scale: Tensor | None = None,
        air: BanksAlongBeams | None = None,
        sizes: Tensor | None = None,
    ) -> tuple[Tensor, None]:
        """Lambda as ``between``; where the particles of a signal are follows from it. Arguments as of ``between``."""
        return self.between(beam, extinction_per_m, density_scale, air, sizes), None

    def start(self, reach_m: Tensor) -> Tensor | None:
        """Place on the grid from which particles count; ``None`` is its first node."""
        return self.grid.position(PUBLISHED_START * reach_m) if self.published else None

    def signal_at(self, row: Tensor, beam: Beam) -> Tensor:
        """Signal at a place on the axis of signals."""
        return torch.exp(self.log_low + self.log_step * row)

    def parameters_of_table(self) -> tuple[Tensor, ...]:
        """Parameters of ``between`` besides the beam and the extinction, as far as it can change."""
        return self.rate_mm_per_h, self.q_back

    def variates(self) -> tuple[Variate, ...]:
        """Arrivals (the E of ``strongest.py``, as ``1 - exp(-E)``) and places of the strongest of each beam."""
        shape = (self.echoes, "N")
        return Variate(f"{self.kind}_arrival", "uniform", shape), Variate(f"{self.kind}_place", "uniform", shape)

    def _echoes(self, beam: Beam) -> int:
        """Number of particles above threshold that a beam exceeds with a probability below ``SHARE_MORE``."""
        with torch.no_grad():
            # `expected_above` at the threshold and the farthest range, from the two nodes of the signal beside it.
            row = ((torch.log(beam.threshold) - self.log_low) / self.log_step).clamp(0.0, SIGNAL_NODES - 1)
            node = row.floor().clamp_max(SIGNAL_NODES - 2)
            clear = torch.zeros(self.rate_mm_per_h.numel())
            nodes = torch.stack([node, node + 1.0])
            if uses_compiled() and not self.published and not is_exporting():
                above = self.compiled_between(beam, clear, nodes=nodes)[..., -1].flip(1).cumsum(1).flip(1)
            else:
                above = (self._per_m(beam, clear, nodes) * self.grid.quadrature_width_m).sum((-2, -1))
            logs = (above + NOTHING).log()
            mean = float((torch.lerp(logs[:, 0], logs[:, 1], row - node).exp() - NOTHING).max())
        term = share = math.exp(-mean)
        for number in range(1, MOST_PARTICLES):
            if 1.0 - share < SHARE_MORE:
                return max(1, number - 1)
            term *= mean / number
            share += term
        return MOST_PARTICLES


def _q_back(weather: Rain | Snow, sensor: Lidar, given: float | str | None) -> float:
    if isinstance(given, str):
        check_one_of("q_back", given, ("glints",), owner="BeamParticles")
        if isinstance(weather, Snow):
            raise InputValueError(
                'BeamParticles: q_back="glints" is for drops; flakes have Snow(flake_reflectivity=...).'
            )
        index = water_refractive_index(sensor.wavelength_nm, weather.temperature_c)
        return float(axial_q_back(index, diameter_mm=1.0, wavelength_nm=sensor.wavelength_nm))
    if given is not None:
        check_positive("q_back", given, owner="BeamParticles")
        return float(given)
    if isinstance(weather, Snow):
        # A Lambertian disk of reflectivity rho returns rho / pi per steradian, which is Q_back / (4 pi).
        return 4.0 * weather.reflectivity_at(sensor.wavelength_nm)
    return rain_q_back(sensor.wavelength_nm)
