"""Effects of LiDAR that lie in the air, on the surfaces and in the optics, before the receiver decides.

Signals are powers: x dB is a factor of ``10^(x / 10)``. Bounds and typical sizes are orders of magnitude where no
source is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.core.errors import InputValueError
from torchweather.core.random import Variate
from torchweather.lidar.intensity import intensity_of_reflectivity
from torchweather.lidar.stages import DB, exponential
from torchweather.lidar.state import LidarState
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind

__all__ = [
    "LidarBeamDivergence",
    "LidarExtinctionScale",
    "LidarLimitedExtent",
    "LidarNearResponse",
    "LidarParticleBackscatter",
    "LidarPatchyWeather",
    "LidarSectorLoss",
    "LidarSpray",
    "LidarStaticStructure",
    "LidarWetTarget",
    "LidarWindowLoss",
]

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))

STRUCTURE_REFLECTIVITY = 0.1  # of a static structure; that of the target a LiDAR's range is specified for
WATER_INDEX = 1.33  # visible and near infrared
WET_SHARE_FACING = (
    0.5  # of the darkening by a film, seen along the normal; the rest is Fresnel loss, order of magnitude
)
SPRAY_LENGTH_M = 5.0  # over which spray thins out by e behind a wheel; order of magnitude
SPRAY_MARGIN_DB = 3.0  # mean margin of a spray return over the threshold; order of magnitude

AZIMUTH_RAD = Parameter("azimuth_rad", "rad", -2.0 * math.pi, 2.0 * math.pi, scale=1.0, default=0.0)


def signal_gain(db: Tensor) -> Tensor:
    """Factor of a power, from decibels."""
    return torch.exp(DB * db)


def sector(state: LidarState, azimuth_rad: Tensor, width_rad: Tensor) -> Tensor:
    """``(B, N)`` bool: whether a beam's azimuth is within half the width of the given one; arguments ``() or (B, 1)``.

    By the length of the chord on the unit circle, ``2 sin(width / 4)``, which knows no jump from pi to -pi. A beam
    whose direction is not known, or that points straight up, is in no sector.
    """
    x, y, _ = along_beam(state)
    square = x * x + y * y
    known = square > 0
    per_length = torch.where(known, square, 1.0).rsqrt()
    chord = (x * per_length - azimuth_rad.cos()).square() + (y * per_length - azimuth_rad.sin()).square()
    # A millionth more, so that a full turn holds the beam that points the other way in single precision too.
    return known & (chord <= 4.0 * (1.0 + 1e-6) * torch.sin(0.25 * width_rad).square())


def along_beam(state: LidarState) -> tuple[Tensor, Tensor, Tensor]:
    """x, y, z ``(B, N)`` of a place on each beam: the object, or one at 1 m where there is none; zero if not known."""
    place = list(state.scene.points_in[..., :3].unbind(-1))
    if state.scene.empty_direction is not None:
        seen, given = (
            state.scene.clear_range_m > 0,
            state.scene.empty_direction.to(state.scene.points_in.dtype).unbind(-1),
        )
        place = [torch.where(seen, own, other) for own, other in zip(place, given, strict=True)]
    x, y, z = place
    return x, y, z


class LidarBeamDivergence(Effect):
    """The beam widens more than modelled: more particles in it, each with a smaller share of the light.

    Objects fill the beam either way and stay as they are.

    Args:
        extra_mrad: divergence over that of the sensor, full angle, 0 to 10 mrad.

    Note:
        Modes that list several particles of a beam list as many as the sensor's own divergence calls for. The rain of
        ``variant="d3_4"`` fills a cylinder, which does not widen.
    """

    id: ClassVar[str] = "lidar.beam_divergence"
    title: ClassVar[str] = "the beam widens more than modelled"
    term: ClassVar[str] = "beam divergence"
    # Full angles of automotive LiDAR lie between 0.1 and 5 mrad.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("extra_mrad", "mrad", 0.0, 10.0, scale=1.0, identity=0.0),)
    percollect: ClassVar[str | None] = "Divergence of outgoing beam"
    after: ClassVar[str] = "extinction"
    axes: ClassVar[tuple[str, ...]] = ("particle_range_m", "particle_intensity")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.particle_backscatter": "particle intensity against range: a wider beam takes more from far particles"
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("receiver.extra_divergence_rad", "receiver.threshold", "scene.points_in")
    writes: ClassVar[tuple[str, ...]] = ("receiver.extra_divergence_rad",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The divergence that particles see."""
        extra = self.value("extra_mrad", state.receiver.threshold) * 1e-3
        return {"extra_divergence_rad": extra.expand(state.batch)}


class LidarWindowLoss(Effect):
    """A film of water or dirt on the window: every return loses the same, objects and particles alike.

    Args:
        loss_db: of power, out and back together, 0 to 30 dB.
    """

    id: ClassVar[str] = "lidar.window_loss"
    title: ClassVar[str] = "the window is wet or dirty"
    term: ClassVar[str] = "window (cover) transmission loss"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("loss_db", "dB", 0.0, 30.0, scale=2.0, identity=0.0),)
    after: ClassVar[str] = "particle_returns"
    axes: ClassVar[tuple[str, ...]] = ("margin_db", "intensity")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.threshold_shift": "intensities; without them the two are one",
        "lidar.wet_target": "intensities of particles, and of surfaces at different incidence",
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("returns.signal",)
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """All signals, weaker."""
        return {"signal": state.returns.signal * signal_gain(-self.value("loss_db", state.returns.signal))}


class LidarExtinctionScale(Effect):
    """The extinction of the weather is another than modelled; the number of particles is the same.

    Objects: ``X exp(-2 (f - 1) alpha R)``. Particles are seen through the scaled extinction as well.

    Args:
        factor: f, extinction over the modelled one, 0 to 10.
    """

    id: ClassVar[str] = "lidar.extinction_scale"
    title: ClassVar[str] = "the path takes more or less light than modelled"
    term: ClassVar[str] = "extinction coefficient"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("factor", "1", 0.0, 10.0, scale=0.5, identity=1.0),)
    percollect: ClassVar[str | None] = "Attenuation by atm. aerosol particles and accumulated hydrometeors"
    after: ClassVar[str] = "extinction"
    axes: ClassVar[tuple[str, ...]] = ("range_m",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.limited_extent": "objects far enough to see whether the loss goes on growing with range"
    }
    needs: ClassVar[tuple[str, ...]] = ("extinction_per_m",)
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        "scene.clear_range_m",
        *("air.extinction_per_m", "air.path_density"),
        "returns.signal",
    )
    writes: ClassVar[tuple[str, ...]] = ("air.extinction_per_m", "returns.signal")

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The extinction, and the objects' signals through it."""
        assert state.air.extinction_per_m is not None
        before = state.air.extinction_per_m
        after = before * self.value("factor", before)
        gain = torch.exp(-2.0 * (after - before)[:, None] * state.uniform_m)
        return {"extinction_per_m": after, "signal": state.returns.signal * gain[..., None]}


class LidarWetTarget(Effect):
    """Wet surfaces are darker: objects lose signal, particles do not.

    ``X (1 - share w)``, w = 1 on an upward surface at grazing incidence and where nothing is known. With the upward
    component u of the normal, w falls as ``(1 + u) / 2``: water lies on top and leaves the underside dry. With the
    angle of incidence i it is ``1 - T(i)^2 / (2 T(0)^2)``: the film lets light in and out with Fresnel's transmittance
    T, and mirrors the rest away. Where the state says how wet each surface is (``WetRoad`` in the weather), w is
    multiplied by that, and the share that lies under smooth water keeps ``(1 - share) T(i)^2 / T(0)^2``.

    Args:
        share: of the signal that a wet upward surface loses, 0 to 1.
    """

    id: ClassVar[str] = "lidar.wet_target"
    title: ClassVar[str] = "wet surfaces are darker"
    term: ClassVar[str] = "reflectivity of wet surfaces"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 1.0, scale=0.3, identity=0.0),)
    percollect: ClassVar[str | None] = "Object part surface moisture"
    after: ClassVar[str] = "extinction"
    axes: ClassVar[tuple[str, ...]] = ("incidence", "up", "kind")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.window_loss": "intensities of particles, and of surfaces at different incidence"
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.cos_incidence", "scene.damp", "scene.pool", "scene.up"),
        *("returns.kind", "returns.signal"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The objects' signals, weaker."""
        wet = torch.ones_like(state.scene.clear_range_m)
        if state.scene.up is not None:
            wet = wet * 0.5 * (1.0 + state.scene.up)
        if state.scene.cos_incidence is not None:
            facing = torch.ones_like(state.scene.cos_incidence)
            through = transmittance_into_water(state.scene.cos_incidence) / transmittance_into_water(facing)
            wet = wet * (1.0 - WET_SHARE_FACING * through.square())
        if state.scene.damp is not None:
            wet = wet * state.scene.damp
        gain = 1.0 - self.value("share", wet) * wet
        if state.scene.pool is not None and state.scene.cos_incidence is not None:
            drowned = (1.0 - self.value("share", wet)) * through.square()
            gain = torch.lerp(gain, drowned, state.scene.pool)
        return {
            "signal": torch.where(
                state.returns.kind == OBJECT, state.returns.signal * gain[..., None], state.returns.signal
            )
        }


def transmittance_into_water(cos_incidence: Tensor) -> Tensor:
    """Fresnel's transmittance from air into water, unpolarised."""
    cos_in = cos_incidence.abs().clamp(1e-6, 1.0)
    cos_water = (1.0 - (1.0 - cos_in.square()) / WATER_INDEX**2).sqrt()
    upright = (cos_in - WATER_INDEX * cos_water) / (cos_in + WATER_INDEX * cos_water)
    parallel = (WATER_INDEX * cos_in - cos_water) / (WATER_INDEX * cos_in + cos_water)
    return 1.0 - 0.5 * (upright.square() + parallel.square())


class LidarLimitedExtent(Effect):
    """The weather fills only the first part of the way: no particle and no extinction beyond.

    Objects: ``exp(-2 alpha min(R, L))``; particles are drawn up to ``min(R, L)``.

    Args:
        extent_m: L, 0 m to infinity.
    """

    id: ClassVar[str] = "lidar.limited_extent"
    title: ClassVar[str] = "the weather fills only part of the space"
    term: ClassVar[str] = "spatial extent of the weather"
    # Rain and fog halls are 30 to 200 m long.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("extent_m", "m", 0.0, math.inf, scale=50.0, identity=math.inf),
    )
    percollect: ClassVar[str | None] = "Signal distance in atm. particle volume"
    after: ClassVar[str] = "extinction"
    axes: ClassVar[tuple[str, ...]] = ("range_m", "particle_range_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.extinction_scale": "objects nearer and farther than the extent, and particles beyond it"
    }
    needs: ClassVar[tuple[str, ...]] = ("extinction_per_m",)
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        "scene.clear_range_m",
        *("air.extinction_per_m", "air.path_density", "air.reach_m"),
        "returns.signal",
    )
    writes: ClassVar[tuple[str, ...]] = ("air.reach_m", "returns.signal")

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The objects' signals, given back what they lost beyond, and the range to which particles are seen."""
        assert state.air.extinction_per_m is not None
        extent_m = self.value("extent_m", state.scene.clear_range_m)
        beyond_m = (state.scene.clear_range_m - extent_m).clamp_min(0.0)
        if state.air.path_density is not None:
            beyond_m = beyond_m * state.air.path_density
        gain = torch.exp(2.0 * state.air.extinction_per_m[:, None] * beyond_m)
        return {"signal": state.returns.signal * gain[..., None], "reach_m": torch.minimum(state.air.reach_m, extent_m)}


class LidarStaticStructure(Effect):
    """A vertical structure that the scene does not have, such as a sprinkler's mast or a pole, same in every frame.

    Beams in its sector whose object is farther or absent meet a surface of 10 % reflectivity instead, at the horizontal
    range given, as if it had been in the input.

    Args:
        azimuth_rad: of its middle, from x to y.
        range_m: horizontal, 0 to 300 m.
        width_rad: seen from the sensor, 0 to 2 pi; 0 is none.
    """

    id: ClassVar[str] = "lidar.static_structure"
    title: ClassVar[str] = "a structure stands in the measured scene alone"
    term: ClassVar[str] = "static obstruction"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        AZIMUTH_RAD,
        Parameter("range_m", "m", 0.0, 300.0, scale=10.0, default=10.0),
        Parameter("width_rad", "rad", 0.0, 2.0 * math.pi, scale=0.05, identity=0.0),  # 0.5 m at 10 m
    )
    percollect: ClassVar[str | None] = "Occlusion by objects"
    after: ClassVar[str] = "to_energy"
    axes: ClassVar[tuple[str, ...]] = ("azimuth_rad", "range_m", "frame")
    unmodelled: ClassVar[tuple[str, ...]] = ("log_particle_intensity", "log_particle_intensity_spread")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.sector_loss": "ranges in the sector: a structure returns at one range, a dirty sector at none of its own"
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.clear_signal", "scene.empty_direction", "scene.integral", "scene.points_in"),
        "air.reach_m",
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.sensor", "receiver.threshold"),
    )
    writes: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.clear_signal", "scene.points_in"),
        "air.reach_m",
        *("returns.kind", "returns.range_m", "returns.signal"),
    )

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The cloud as if the structure had been there."""
        assert state.receiver.sensor is not None
        sensor, clear_m = state.receiver.sensor, state.scene.clear_range_m
        azimuth_rad, width_rad = self.value("azimuth_rad", clear_m), self.value("width_rad", clear_m)
        x, y, z = along_beam(state)
        horizontal = (x * x + y * y).sqrt()
        scale = self.value("range_m", clear_m) / horizontal.clamp_min(1e-6)
        slant_m = scale * (x * x + y * y + z * z).sqrt()
        free = (clear_m == 0) | (clear_m > slant_m)
        reached = (slant_m >= sensor.min_range_m) & (slant_m <= sensor.max_range_m)
        met = sector(state, azimuth_rad, width_rad) & free & reached
        seen_m = slant_m.clamp(1e-3, sensor.max_range_m)
        own_signal = STRUCTURE_REFLECTIVITY / math.pi * sensor.near_response(seen_m) / seen_m.square()
        photons = own_signal * (sensor.photons_at_threshold / state.receiver.threshold)
        reflectivity = torch.full_like(own_signal, STRUCTURE_REFLECTIVITY)
        intensity = intensity_of_reflectivity(reflectivity, photons, sensor.intensity_unit, state.scene.integral)
        columns = list(state.scene.points_in.unbind(-1))
        place = (x * scale, y * scale, z * scale, intensity)
        columns[:4] = [torch.where(met, new, old) for new, old in zip(place, columns[:4], strict=True)]
        range_m = torch.where(met, slant_m, clear_m)
        signal = torch.where(met, own_signal, state.scene.clear_signal)
        return {
            "points_in": torch.stack(columns, -1),
            "clear_range_m": range_m,
            "clear_signal": signal,
            "range_m": _first(range_m, state.returns.range_m),
            "signal": _first(signal, state.returns.signal),
            "kind": _first(torch.where(met, OBJECT, state.returns.kind[..., 0]).to(torch.int8), state.returns.kind),
            "reach_m": torch.where(met, slant_m, state.air.reach_m),
        }


def _first(one: Tensor, echoes: Tensor) -> Tensor:
    """Echoes ``(B, N, E)`` with another first one."""
    return torch.cat([one[..., None], echoes[..., 1:]], -1)


class LidarParticleBackscatter(Effect):
    """Drops, flakes or droplets are brighter or darker than modelled; objects stay.

    Args:
        gain_db: of the particles' power, -20 to 10 dB.

    Note:
        Fog's readings, photon noise included, are scaled as a whole. Those below a tenth of the threshold are not
        drawn, so 10 dB are the most. The least is for sensors that see objects much farther than flakes tell: the
        snow of WADS is 16 dB fainter than a Lambertian flake beside objects at 200 m (10 %).
    """

    id: ClassVar[str] = "lidar.particle_backscatter"
    title: ClassVar[str] = "particles are brighter or darker than modelled"
    term: ClassVar[str] = "backscatter efficiency"
    # The backscatter of drops is uncertain between 0.094 and 0.6, 8 dB (PHYSICS.md 3.2).
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("gain_db", "dB", -20.0, 10.0, scale=3.0, identity=0.0),)
    percollect: ClassVar[str | None] = "Backscattering by atm. aerosol particles and accumulated hydrometeors"
    after: ClassVar[str] = "particle_returns"
    rank: ClassVar[int] = -2
    axes: ClassVar[tuple[str, ...]] = ("particle_range_m", "particle_intensity")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.beam_divergence": "particle intensity against range: a wider beam takes more from far particles"
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.signal")
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold, of all samples."""
        return float(signal_gain(self.get_buffer("gain_db")).max())

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The particles' signals."""
        gained = state.returns.signal * signal_gain(self.value("gain_db", state.returns.signal))
        return {"signal": torch.where(state.returns.kind == PARTICLE, gained, state.returns.signal)}


class LidarNearResponse(Effect):
    """The receiver takes less of the light of near particles than modelled; objects stay.

    The factor is ``min(1, R / full_m)^power``, times the near-range response of the sensor. It acts before the
    strongest particle of a beam is chosen: where near particles are faint, farther ones are reported.

    Args:
        full_m: range from which on the receiver takes all of the light, 1 to 100 m.
        power: of the factor, 0 to 4; 0 is no change.

    Note:
        The response of an OS2-128 was measured as ``(R / 30 m)^2`` on its own sweeps. The nodes of fog's readings are
        those of the sensor's own response: where the effect leaves a tenth of the light, fog's mean reading is right
        to 10 %.
    """

    id: ClassVar[str] = "lidar.near_response"
    title: ClassVar[str] = "near particles are fainter than modelled"
    term: ClassVar[str] = "near-range response, overlap function"
    # Ends of 3 to 30 m and powers of 1 to 2 were fitted to sweeps of automotive LiDARs.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("full_m", "m", 1.0, 100.0, scale=10.0, default=15.0),
        Parameter("power", "1", 0.0, 4.0, scale=1.0, identity=0.0),
    )
    percollect: ClassVar[str | None] = None
    after: ClassVar[str] = "extinction"
    axes: ClassVar[tuple[str, ...]] = ("particle_range_m", "particle_intensity")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.particle_backscatter": "particle intensity against range: the response changes near particles alone",
        "lidar.blind_zone": "the range of the nearest returns: a zone ends at one range, a response fades",
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("receiver.extra_near_full_m", "receiver.extra_near_power", "receiver.threshold"),
        "scene.points_in",
    )
    writes: ClassVar[tuple[str, ...]] = ("receiver.extra_near_full_m", "receiver.extra_near_power")

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The response to particles."""
        if state.receiver.extra_near_power is not None:
            raise InputValueError(
                f"{type(self).__name__}: expected one near-range response in a chain, got a second one. Keep one of "
                "them, with the range and the power of both."
            )
        full_m, power = (self.value(name, state.receiver.threshold) for name in ("full_m", "power"))
        return {"extra_near_full_m": full_m.expand(state.batch), "extra_near_power": power.expand(state.batch)}


class LidarSectorLoss(Effect):
    """A dirty part of the window: every return of the beams that pass through it loses the same.

    Args:
        azimuth_rad: of the sector's middle, from x to y.
        width_rad: of the sector, 0 to 2 pi.
        loss_db: of power, out and back together, 0 to 30 dB.
    """

    id: ClassVar[str] = "lidar.sector_loss"
    title: ClassVar[str] = "a sector of the window is dirty"
    term: ClassVar[str] = "partial blockage of the window"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        AZIMUTH_RAD,
        Parameter("width_rad", "rad", 0.0, 2.0 * math.pi, scale=0.5, default=0.5),
        Parameter("loss_db", "dB", 0.0, 30.0, scale=3.0, identity=0.0),
    )
    after: ClassVar[str] = "particle_returns"
    axes: ClassVar[tuple[str, ...]] = ("azimuth_rad",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.static_structure": "ranges in the sector: a structure returns at one range, a dirty sector at none of "
        "its own",
        "lidar.spray": "ranges in the sector: spray returns near the sensor",
        "lidar.ring_gain": "intensities against azimuth",
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        "returns.signal",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signals in the sector, weaker."""
        like = state.scene.clear_range_m
        inside = sector(state, self.value("azimuth_rad", like), self.value("width_rad", like))
        weaker = state.returns.signal * signal_gain(-self.value("loss_db", state.returns.signal))
        return {"signal": torch.where(inside[..., None], weaker, state.returns.signal)}


class LidarPatchyWeather(Effect):
    """Gusts and banks: the density of the particles differs from frame to frame, log-normally with mean 1.

    ``exp(s n - s^2 / 2)`` with one standard normal n a sample; extinction and particles follow it together.

    Args:
        log_std: s, 0 to 2.

    Note:
        Modes that list several particles of a beam list as many as the mean density calls for.
    """

    id: ClassVar[str] = "lidar.patchy_weather"
    title: ClassVar[str] = "the weather comes in gusts and banks"
    term: ClassVar[str] = "inhomogeneous (intermittent) particle density"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("log_std", "1", 0.0, 2.0, scale=0.3, identity=0.0),)
    percollect: ClassVar[str | None] = (
        "Spatial differences in number concentration of atm. particles within particle volume"
    )
    after: ClassVar[str] = "to_energy"
    axes: ClassVar[tuple[str, ...]] = ("frame",)
    # Not ``scatters``: the search takes what that does to each entry for scatter of its own, and names it for what
    # differs along the scan in all frames alike, as a ripple over the azimuth.
    frame_density: ClassVar[str | None] = "log_std"
    of_the_air: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("air.density_scale", "returns.signal")
    writes: ClassVar[tuple[str, ...]] = ("air.density_scale",)

    def variates(self) -> tuple[Variate, ...]:
        """One number a sample."""
        return (Variate("density", "normal", (1,)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Density over that of the weather."""
        drawn = noise["density"][:, 0].to(state.returns.signal)
        log_std = self.value("log_std", drawn)
        density = torch.exp(log_std * drawn - 0.5 * log_std.square())
        return {"density_scale": density if state.air.density_scale is None else density * state.air.density_scale}


class LidarSpray(Effect):
    """Spray of wheels: returns near the sensor in a sector, an echo more that the receiver may report.

    The drops seen in front of range R are a Poisson process of mean ``strength (1 - exp(-(R - R0) / 5 m))``, R0 being
    where the receiver begins to see; their margins over the threshold are exponential with a mean of 3 dB. The
    strongest of them is drawn: with mean mu and a standard exponential E its margin is ``3 dB ln(mu / E)``, and there
    is none where E exceeds mu.

    Args:
        strength: expected number of spray returns above threshold in a free beam of the sector, 0 to 50.
        azimuth_rad: of the sector's middle, from x to y; behind the vehicle unless given.
        width_rad: of the sector, 0 to 2 pi.

    Note:
        The spray takes no light from what lies behind it.
    """

    id: ClassVar[str] = "lidar.spray"
    title: ClassVar[str] = "wheels throw up spray"
    term: ClassVar[str] = "road spray"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("strength", "1", 0.0, 50.0, scale=0.3, identity=0.0),
        Parameter("azimuth_rad", "rad", -2.0 * math.pi, 2.0 * math.pi, scale=1.0, default=math.pi),
        Parameter("width_rad", "rad", 0.0, 2.0 * math.pi, scale=0.5, default=0.5),
    )
    after: ClassVar[str] = "particle_returns"
    rank: ClassVar[int] = -1
    axes: ClassVar[tuple[str, ...]] = ("azimuth_rad", "particle_range_m", "ego_speed_m_per_s")
    unmodelled: ClassVar[tuple[str, ...]] = ("log_particle_intensity", "log_particle_intensity_spread")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.sector_loss": "ranges in the sector: spray returns near the sensor"
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        "air.reach_m",
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.sensor", "receiver.threshold", "receiver.threshold_scale"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.range_m", "returns.signal")

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def variates(self) -> tuple[Variate, ...]:
        """Arrival (the E above, as ``1 - exp(-E)``) and place of the strongest return of each beam."""
        return Variate("arrival", "uniform", ("N",)), Variate("place", "uniform", ("N",))

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """An echo more."""
        assert state.receiver.sensor is not None
        like = state.scene.clear_range_m
        start_m = max(state.receiver.sensor.near_start_m, state.receiver.sensor.min_range_m)
        end_m = torch.where(like > 0, like, state.air.reach_m)
        seen = -torch.expm1((end_m - start_m).clamp_min(0.0) * (-1.0 / SPRAY_LENGTH_M))
        inside = sector(state, self.value("azimuth_rad", like), self.value("width_rad", like))
        mean = torch.where(inside, self.value("strength", like) * seen, 0.0)
        arrival = exponential(noise["arrival"].to(like))
        there = arrival < mean
        # Logarithms only where there is a return, and of an arrival that may be 0 in single precision.
        above = torch.where(there, mean, 1.0).log() - torch.where(there, arrival, 1.0).clamp_min(1e-9).log()
        signal = torch.where(there, state.detected_from * torch.exp(SPRAY_MARGIN_DB * DB * above), 0.0)
        range_m = start_m - SPRAY_LENGTH_M * torch.log1p(-noise["place"].to(like) * seen)
        echo = {
            "range_m": torch.where(there, range_m, 0.0),
            "signal": signal,
            "kind": torch.full_like(state.returns.kind[..., 0], PARTICLE),
        }
        return {name: torch.cat([state.field(name), more[..., None]], -1) for name, more in echo.items()}
