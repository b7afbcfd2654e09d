"""Effects of LiDAR that change where the particles are, and which: over azimuth and elevation, by size, in two beams.

Snow about a moving vehicle is not alike all around: the wake raises it, the lee lacks it, wind carries it to one side.
The density of a beam is that of the weather times a factor that is constant along the beam. The expected number of
particles is then that factor times the weather's, ``Lambda = d Lambda_0``, and the strongest particle of the beam,
``Lambda(e*, R) = E``, is that of the weather at the arrival ``E / d``: exact, with the same table for all beams.

References:
    PHYSICS.md 5.3 (the strongest particle), 5.9 (WADS). Azimuth and elevation in WADS: docs/lidar-snow-structure.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.core.random import Variate
from torchweather.lidar.effects.air import along_beam
from torchweather.lidar.returns.beam_particles import SIZE_KNOTS_MM
from torchweather.lidar.state import LidarState
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind

__all__ = [
    "LidarParticleDensityAzimuth",
    "LidarParticleDensityElevation",
    "LidarParticleSizes",
    "LidarSharedParticles",
    "beam_overlap",
    "lobe",
]

PARTICLE = int(PointKind.PARTICLE)
MOST = 20.0  # density of a lobe over that beside it, less 1; order of magnitude
NARROWEST_RAD = 0.01
LN_2 = math.log(2.0)
FAR = 1e4  # square of the distance from a lobe's middle over half its width; its eighth power is a number still
ENDS = 1e-6  # of the overlap's argument, where its derivative ends


def lobe(
    along: tuple[Tensor, Tensor], middle_rad: Tensor, width_rad: Tensor, steepness: Tensor | None = None
) -> Tensor:
    """A bump on the circle, 1 in its middle and 1/2 at half its width either side: ``2^-(chord / half_chord)^(2 m)``.

    Args:
        along: cosine and sine of the angle, ``(B, N)`` each.
        middle_rad: ``()`` or ``(B, 1)``.
        width_rad: full width at half of the height, above 0 to 2 pi, likewise.
        steepness: m, 1 or more, likewise; ``None`` is 1, a normal curve. The edges of 8 are nearly upright.

    Returns:
        ``(B, N)``, above 0 to 1.

    Example:
        >>> angle = torch.tensor([0.0, 0.25, math.pi])
        >>> lobe((angle.cos(), angle.sin()), torch.tensor(0.0), torch.tensor(0.5)).round(decimals=3)
        tensor([1.0000, 0.5000, 0.0000])
    """
    cosine, sine = along
    chord_square = (cosine - middle_rad.cos()).square() + (sine - middle_rad.sin()).square()
    ratio = chord_square / (4.0 * torch.sin(0.25 * width_rad).square())
    # A power of 0 has no gradient in the exponent.
    return torch.exp(-LN_2 * (ratio if steepness is None else ratio.clamp(1e-12, FAR) ** steepness))


def _denser(state: LidarState, factor: Tensor, known: Tensor) -> dict[str, Tensor]:
    """The density of each beam times a factor; of a beam without a direction as before."""
    factor = torch.where(known, factor, 1.0)
    return {"beam_density": factor if state.air.beam_density is None else state.air.beam_density * factor}


class LidarParticleDensityAzimuth(Effect):
    """More or fewer particles to some sides of the vehicle: wake, lee and wind.

    ``d = (1 + amplitude lobe(azimuth)) (1 + wind_amplitude cos(azimuth - wind_azimuth))``. The lobe is 1 in its middle
    and 1/2 at half its width to either side. A wake is an amplitude above 0 to the rear, a lee one below 0.

    Args:
        amplitude: density in the middle of the lobe over that beside it, less 1; -1 (none) to 20.
        azimuth_rad: of the lobe's middle, from x to y; behind the vehicle unless given.
        width_rad: of the lobe, full width at half of the height, 0.01 to 2 pi.
        wind_amplitude: of the first harmonic, 0 to 1.
        wind_azimuth_rad: of the side that has more; the left unless given.

    Note:
        Particles and extinction of a beam follow its density; the extinction in front of a particle, which dims it, is
        that of the weather. Fog's readings, photon noise included, are scaled. Modes that list several particles of a
        beam list as many as the weather's own density calls for. A beam of unknown direction keeps its density.
    """

    id: ClassVar[str] = "lidar.particle_density_azimuth"
    title: ClassVar[str] = "wake, lee and wind make the weather differ around the vehicle"
    term: ClassVar[str] = "azimuthal density of airborne particles"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("amplitude", "1", -1.0, MOST, scale=1.0, identity=0.0),  # WADS: 1.6 to 2.5
        Parameter("azimuth_rad", "rad", -2.0 * math.pi, 2.0 * math.pi, scale=1.0, default=math.pi),
        Parameter("width_rad", "rad", NARROWEST_RAD, 2.0 * math.pi, scale=0.5, default=0.5),
        Parameter("wind_amplitude", "1", 0.0, 1.0, scale=0.3, identity=0.0),
        Parameter("wind_azimuth_rad", "rad", -2.0 * math.pi, 2.0 * math.pi, scale=1.0, default=0.5 * math.pi),
    )
    percollect: ClassVar[str | None] = (
        "Spatial differences in number concentration of atm. particles within particle volume"
    )
    after: ClassVar[str] = "to_energy"
    axes: ClassVar[tuple[str, ...]] = ("azimuth_rad",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.spray": "ranges: spray returns near the sensor, a wake wherever the weather does",
        "lidar.sector_loss": "objects in the sector, which a dirty window dims and a lee does not",
    }
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        "air.beam_density",
    )
    writes: ClassVar[tuple[str, ...]] = ("air.beam_density",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The density of each beam."""
        x, y, _ = along_beam(state)
        square = x * x + y * y
        known = square > 0  # straight up is no azimuth
        per_length = torch.where(known, square, 1.0).rsqrt()
        along = x * per_length, y * per_length
        bump = lobe(along, self.value("azimuth_rad", x), self.value("width_rad", x))
        wind_rad = self.value("wind_azimuth_rad", x)
        to_wind = along[0] * wind_rad.cos() + along[1] * wind_rad.sin()
        wake = 1.0 + self.value("amplitude", x) * bump
        return _denser(state, wake * (1.0 + self.value("wind_amplitude", x) * to_wind), known)


class LidarParticleDensityElevation(Effect):
    """More or fewer particles in beams of some elevations: blowing snow near the ground, a layer, a sheltered roof.

    ``d = 1 + amplitude lobe(elevation)``, the lobe being 1 in its middle and 1/2 at half its width above and below.

    Args:
        amplitude: density in the middle of the lobe over that beside it, less 1; -1 (none) to 20.
        elevation_rad: of its middle, up from the sensor's horizon, -pi/2 to pi/2.
        width_rad: full width at half of the height, 0.01 to 2 pi.
        steepness: of its edges, 1 (a normal curve) to 8 (a layer with a top).

    Note:
        As of ``LidarParticleDensityAzimuth``.
    """

    id: ClassVar[str] = "lidar.particle_density_elevation"
    title: ClassVar[str] = "the weather is denser at some elevations"
    term: ClassVar[str] = "elevation profile of airborne particles"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("amplitude", "1", -1.0, MOST, scale=1.0, identity=0.0),  # WADS: 1.1
        Parameter("elevation_rad", "rad", -0.5 * math.pi, 0.5 * math.pi, scale=0.1, default=0.0),
        Parameter("width_rad", "rad", NARROWEST_RAD, 2.0 * math.pi, scale=0.1, default=0.1),
        Parameter("steepness", "1", 1.0, 8.0, scale=1.0, default=1.0),
    )
    percollect: ClassVar[str | None] = (
        "Spatial differences in number concentration of atm. particles within particle volume"
    )
    after: ClassVar[str] = "to_energy"
    axes: ClassVar[tuple[str, ...]] = ("elevation_rad",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.ring_gain": "objects, which a ring's gain dims as well, and intensities of particles"
    }
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        "air.beam_density",
    )
    writes: ClassVar[tuple[str, ...]] = ("air.beam_density",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The density of each beam."""
        x, y, z = along_beam(state)
        square = x * x + y * y + z * z
        known = square > 0
        per_length = torch.where(known, square, 1.0).rsqrt()
        # The root of 0, straight up, would have no gradient.
        level = (x * x + y * y).clamp_min(1e-20).sqrt()
        along = level * per_length, z * per_length
        where = (self.value(name, x) for name in ("elevation_rad", "width_rad", "steepness"))
        bump = lobe(along, *where)
        return _denser(state, 1.0 + self.value("amplitude", x) * bump, known)


class LidarParticleSizes(Effect):
    """A size distribution of free shape: the number of particles of each size over that of the weather.

    The factor is linear in the logarithm of the diameter between the knots, and constant beyond: outlines of 1, 2, 4
    and 8 mm. ``n(D) -> f(D) n(D)``, so the number of particles that return more than a signal is linear in the four
    factors, and they can be found from counts by non-negative least squares.

    Args:
        factor_1mm, factor_2mm, factor_4mm, factor_8mm: at the knots, 0 to 100.

    Note:
        For fitting. The extinction is that of the weather. Fog has no such sizes and stays. Modes that list several
        particles of a beam list as many as the weather calls for.
    """

    id: ClassVar[str] = "lidar.particle_sizes"
    title: ClassVar[str] = "particles have other sizes than modelled"
    term: ClassVar[str] = "particle size distribution"
    arguments: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(f"factor_{knot:g}mm", "1", 0.0, 100.0, scale=0.5, identity=1.0) for knot in SIZE_KNOTS_MM
    )
    after: ClassVar[str] = "extinction"
    axes: ClassVar[tuple[str, ...]] = ("particle_range_m", "particle_intensity")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.particle_backscatter": "the shape over range: brighter particles are seen farther at every size",
        "lidar.beam_divergence": "particle intensity against range: a wider beam takes more from far particles",
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("air.size_factors", "returns.signal", "scene.points_in")
    writes: ClassVar[tuple[str, ...]] = ("air.size_factors",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The factors, ``(B, 4)``."""
        found = [self.value(one.name, state.returns.signal[:, 0, 0]).expand(state.batch) for one in self.arguments]
        return {"size_factors": torch.stack(found, -1)}


def beam_overlap(apart_m: Tensor, diameter_m: Tensor) -> Tensor:
    """Share of a beam's cross-section that its neighbour covers too.

    Of two disks, ``(2 / pi) (acos x - x sqrt(1 - x^2))`` with ``x = apart / diameter``.

    Args:
        apart_m: distance of their middles.
        diameter_m: of both.

    Returns:
        1 where they are one, 0 where x is 1 or more.

    Example:
        >>> beam_overlap(torch.tensor([0.0, 0.01, 0.02]), torch.tensor(0.02)).round(decimals=3)
        tensor([1.0000, 0.3910, 0.0000])
    """
    x = (apart_m / diameter_m).clamp(0.0, 1.0 - ENDS)
    overlap = (2.0 / math.pi) * (torch.acos(x) - x * (1.0 - x * x).sqrt())
    return torch.where(apart_m < diameter_m * (1.0 - ENDS), overlap, torch.zeros_like(overlap))


class LidarSharedParticles(Effect):
    """A particle where neighbouring beams overlap returns in each of them, at one range.

    The neighbour of a beam is the row before it. With the chance that is the share of the cross-section that both have
    (beam width and step width, at the range of the particles) a beam has the particles of its neighbour in place of
    its own. The chance is the mean of the shares at both beams' particles and so alike for both; the number of returns,
    and their law in range and signal, is then the same as without.

    Args:
        share: of the geometric overlap, 0 to 1.
        width_factor: width of a beam as particles see it over that of the sensor, 0.1 to 30.

    Note:
        Rows must lie along the scan, a ring after the other; where neighbours in the cloud are more than a beam apart
        nothing is shared, nor across rings. In a run of beams that share, each takes over with a chance at its own
        range. A beam that ends in front of a particle of the other keeps its own. Readings of fog are taken along.
    """

    id: ClassVar[str] = "lidar.shared_particles"
    title: ClassVar[str] = "one particle returns in two neighbouring beams"
    term: ClassVar[str] = "beam overlap (oversampling)"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("share", "1", 0.0, 1.0, scale=0.5, identity=0.0),
        Parameter("width_factor", "1", 0.1, 30.0, scale=0.5, default=1.0),
    )
    after: ClassVar[str] = "particle_returns"
    rank: ClassVar[int] = -4
    axes: ClassVar[tuple[str, ...]] = ("clustered_share",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.isolated_return_filter": "numbers of returns, which a filter lowers"
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        "air.reach_m",
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.extra_divergence_rad", "receiver.sensor"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.range_m", "returns.signal")

    def variates(self) -> tuple[Variate, ...]:
        """A number a beam."""
        return (Variate("neighbour", "uniform", ("N",)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Echoes of particles, those of the row before where the two beams share them."""
        like = state.scene.clear_range_m
        particle = state.returns.kind == PARTICLE
        range_m = torch.where(particle & (state.returns.signal > 0), state.returns.range_m, 0.0)
        # The strongest is listed first; the farthest decides whether both beams reach it.
        strongest = range_m.gather(-1, torch.where(particle, state.returns.signal, -1.0).argmax(-1, keepdim=True))[
            ..., 0
        ]
        farthest = range_m.amax(-1)
        before, farthest_before = _before(strongest), _before(farthest)
        reached = (farthest < _before(state.air.reach_m)) & (farthest_before < state.air.reach_m)
        own = torch.where(strongest > 0, strongest, before)
        other = torch.where(before > 0, before, strongest)
        x, y, z = along_beam(state)
        square = x * x + y * y + z * z
        along = torch.stack([x, y, z], -1) * square.clamp_min(1e-20).rsqrt()[..., None]  # (B, N, 3)
        step = torch.linalg.vector_norm(along - _before(along), dim=-1)  # the angle, rad, as far as it matters
        chance = 0.5 * (self._overlap(state, step, own) + self._overlap(state, step, other))
        row = torch.arange(like.shape[-1], device=like.device)
        linked = (noise["neighbour"].to(like) < self.value("share", like) * chance) & reached & (row > 0)
        linked = linked & (square > 0) & _before(square > 0)
        source = torch.where(linked, row - 1, row)
        for _ in range(LINKS):  # each time twice as far
            source = source.gather(1, source)
        source = torch.where(farthest.gather(1, source) < state.air.reach_m, source, row)
        found = {}
        for name in FIELDS:
            echoes = state.field(name)
            found[name] = torch.where(particle, echoes.gather(1, source[..., None].expand_as(echoes)), echoes)
        return found

    def _overlap(self, state: LidarState, step_rad: Tensor, range_m: Tensor) -> Tensor:
        """Share of the cross-section at a range that two beams have together; 0 at range 0."""
        assert state.receiver.sensor is not None
        divergence_rad = 1e-3 * state.receiver.sensor.divergence_mrad + torch.zeros_like(range_m)
        if state.receiver.extra_divergence_rad is not None:
            divergence_rad = divergence_rad + state.receiver.extra_divergence_rad.to(range_m)[:, None]
        width_m = 1e-3 * state.receiver.sensor.exit_diameter_mm + divergence_rad * range_m
        overlap = beam_overlap(step_rad * range_m, width_m * self.value("width_factor", range_m))
        return torch.where(range_m > 0, overlap, 0.0)


LINKS = 6  # doublings: a particle is in 64 beams at most
FIELDS = ("range_m", "signal", "kind")


def _before(values: Tensor) -> Tensor:
    """Values of the row before, ``(B, N, ...)``; the first row has its own."""
    return torch.cat([values[:, :1], values[:, :-1]], 1)
