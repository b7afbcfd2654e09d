"""The twenty effects of the catalogue in code of their own; nine of them in another form than the obvious one.

Names and parameters are those of the catalogue. Where ``same_form`` is false the parameter is the one that comes
nearest: the middle of a soft edge, the level at which a film saturates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from .lidar_sensor import NO_ECHO, OTHER, PARTICLE, Echoes, Effect, Report, Shot, View
from .rays import Target
from .scene import FloatArray

__all__ = ["CATALOGUE", "Known"]


def _power(db: FloatArray | float) -> FloatArray:
    return np.asarray(10.0 ** (0.1 * np.asarray(db)))


def _turn(angle_rad: FloatArray) -> FloatArray:
    """An angle in -pi..pi."""
    return np.asarray(np.mod(angle_rad + np.pi, 2.0 * np.pi) - np.pi)


def _scale_all(echoes: Echoes, gain: FloatArray) -> None:
    """Multiply every echo of a beam by its gain ``(N,)``."""
    echoes.target = echoes.target * gain
    echoes.signal = echoes.signal * gain[echoes.beam]


@dataclass
class Known(Effect):
    """An effect of the catalogue with its parameters.

    ``swept`` is the parameter that sets its strength, ``weak`` and ``strong`` the ends between which the strength is
    looked for; ``fixed`` draws the others; ``differs`` says that it is another one in every frame.
    """

    parameters: dict[str, float]
    name: ClassVar[str] = ""
    same_form: ClassVar[bool] = True
    swept: ClassVar[str] = ""
    weak: ClassVar[float] = 0.0
    strong: ClassVar[float] = 0.0
    two_sided: ClassVar[bool] = False
    differs: ClassVar[bool] = False

    @property
    def value(self) -> float:
        """The swept parameter."""
        return self.parameters[self.swept]

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        """The parameters that are not swept, drawn."""
        return {}

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        """The effect where ``strength`` (0 to 1, or -1 to 1 where both signs have a meaning) sets the swept one."""
        size = cls.weak * (cls.strong / cls.weak) ** abs(strength)
        return cls({cls.swept: float(np.sign(strength) * size), **fixed})


class BeamDivergence(Known):
    """The cone widens more: more particles inside, each with a smaller share of the light."""

    name, swept, weak, strong = "beam_divergence", "extra_mrad", 0.01, 4.0

    def prepare(self, shot: Shot) -> None:
        shot.extra_divergence_rad += 1e-3 * self.value


class IsolatedReturnFilter(Known):
    """Removes a return with no other of the 5 x 5 around it within a sphere (the obvious form: 3 x 3, along range)."""

    name, swept, weak, strong = "isolated_return_filter", "probability", 0.0005, 1.0
    same_form = False
    reach = 2

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"radius_m": float(rng.uniform(0.5, 1.2))}

    def on_report(self, shot: Shot, report: Report) -> None:
        rings, columns = shot.view.scan.shape
        flat = shot.view.scan.direction.reshape(-1, 3)
        point = (flat * report.range_m[..., None]).reshape(-1, rings, columns, 3).astype(np.float32)
        there = (report.range_m > 0.0).reshape(-1, rings, columns)
        alone = np.ones_like(there)
        for up in range(-self.reach, self.reach + 1):
            for side in range(-self.reach, self.reach + 1):
                if up == side == 0:
                    continue
                mine = slice(max(0, up), rings + min(0, up))
                other = slice(max(0, -up), rings + min(0, -up))
                moved = np.roll(point, side, axis=2)[:, other]
                near = np.sum((point[:, mine] - moved) ** 2, -1) <= self.parameters["radius_m"] ** 2
                alone[:, mine] &= ~(near & np.roll(there, side, axis=2)[:, other])
        lost = alone.reshape(report.range_m.shape) & (shot.rng.random(shot.shape) < self.value)
        report.drop(lost & (report.range_m > 0.0))


class ThresholdShift(Known):
    """The detection threshold is another one."""

    name, swept, weak, strong, two_sided = "threshold_shift", "shift_db", 0.01, 8.0, True

    def prepare(self, shot: Shot) -> None:
        shot.threshold_gain = shot.threshold_gain * _power(self.value)


class WindowLoss(Known):
    """A wet window whose film saturates with the weather (the obvious form: the same loss at any rate)."""

    name, swept, weak, strong = "window_loss", "loss_db", 0.01, 10.0
    same_form = False
    # Amounts at which the film has 63 % of its full loss: mm/h of rain, mm/h of snow; of fog 100 m / visibility.
    film: ClassVar[Mapping[str, float]] = {"rain": 4.0, "snow": 0.2, "fog": 0.1}

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        weather = shot.weather
        if weather.kind == "clear":
            share = 1.0
        else:
            amount = 100.0 / weather.amount if weather.kind == "fog" else weather.amount
            share = 1.0 - np.exp(-amount / self.film[weather.kind])
        _scale_all(echoes, np.full(shot.shape[1], _power(-self.value * share)))


class ExtinctionScale(Known):
    """The path takes more or less than the weather's particles explain."""

    name, swept, weak, strong, two_sided = "extinction_scale", "factor", 0.005, 1.5, True

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        size = cls.weak * (cls.strong / cls.weak) ** abs(strength)
        return cls({"factor": float((1.0 + size) ** np.sign(strength))})

    def prepare(self, shot: Shot) -> None:
        shot.extinction_factor *= self.value


class WetTarget(Known):
    """Rough level ground darkens most, by its slope alone (the obvious form: with the incidence too)."""

    name, swept, weak, strong = "wet_target", "share", 0.003, 0.9
    same_form = False

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        up = np.nan_to_num(shot.view.target.up)
        echoes.target = echoes.target * (1.0 - self.value * (0.3 + 0.7 * np.clip(up, 0.0, 1.0)))


class BlindZone(Known):
    """The receiver wakes up late, 30 dB down inside, with a soft edge (the obvious form: a sharp cut)."""

    name, swept, weak, strong = "blind_zone", "range_m", 0.2, 9.0
    same_form = False

    def prepare(self, shot: Shot) -> None:
        shot.blind_m = max(shot.blind_m, self.value)


class RangeNoise(Known):
    """Jitter of the timing."""

    name, swept, weak, strong = "range_noise", "std_m", 0.001, 0.5

    def on_report(self, shot: Shot, report: Report) -> None:
        seen = report.range_m > 0.0
        noisy = report.range_m + self.value * shot.rng.standard_normal(shot.shape)
        report.range_m = np.where(seen, np.maximum(noisy, 0.01), 0.0)


class RangeBias(Known):
    """An offset, and a walk with the logarithm of the signal over the threshold."""

    name, swept, weak, strong, two_sided = "range_bias", "offset_m", 0.0003, 0.5, True

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"walk_share": float(rng.choice([0.0, -0.3, -0.6]))}

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        size = np.sign(strength) * cls.weak * (cls.strong / cls.weak) ** abs(strength)
        return cls({"offset_m": float(size), "walk_m_per_decade": float(size * fixed["walk_share"])})

    def on_report(self, shot: Shot, report: Report) -> None:
        seen = report.range_m > 0.0
        decades = np.log10(np.where(seen, report.signal, 1.0) / shot.sensor.threshold_per_m2_sr)
        moved = report.range_m + self.value + self.parameters["walk_m_per_decade"] * decades
        report.range_m = np.where(seen, np.maximum(moved, 0.01), 0.0)


class LimitedExtent(Known):
    """The weather thins out over a tenth of its extent (the obvious form: it ends at once)."""

    name, swept, weak, strong = "limited_extent", "extent_m", 110.0, 2.5
    same_form = False

    def prepare(self, shot: Shot) -> None:
        shot.extent_m = min(shot.extent_m, self.value)
        shot.extent_edge_m = 0.1 * self.value


class LastReturn(Known):
    """Some beams report their last echo: a particle in front of a visible target does not show."""

    name, swept, weak, strong = "last_return", "probability", 0.005, 1.0

    def prepare(self, shot: Shot) -> None:
        shot.last_probability = max(shot.last_probability, self.value)


class StaticStructure(Known):
    """A hedge-like column with a rough front and frayed sides (the obvious form: a smooth upright strip)."""

    name, swept, weak, strong = "static_structure", "width_rad", 0.0005, 0.6
    same_form = False

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"azimuth_rad": float(rng.uniform(-np.pi, np.pi)), "range_m": float(rng.uniform(6.0, 14.0))}

    def on_view(self, view: View) -> View:
        target, scan = view.target, view.scan
        rng = np.random.default_rng(int(1e6 * (self.parameters["azimuth_rad"] + 4.0)))  # the same hedge in every frame
        offset = np.abs(_turn(scan.azimuth_rad - self.parameters["azimuth_rad"])) / (0.5 * self.value)
        leaf = rng.random(view.beams) < np.clip(1.5 - 0.5 * offset**2, 0.0, 1.0) * (offset < 1.5)
        elevation = np.arcsin(scan.direction.reshape(-1, 3)[:, 2])
        front = (self.parameters["range_m"] + 0.15 * rng.standard_normal(view.beams)) / np.cos(elevation)
        hit = leaf & (front < target.range_m) & (elevation < 0.25)
        changed = Target(
            np.where(hit, front, target.range_m),
            np.where(hit, 0.12 * np.exp(0.2 * rng.standard_normal(view.beams)), target.reflectivity),
            np.where(hit, 0.9, target.cos_incidence),
            np.where(hit, 0.0, target.up),
        )
        return replace(view, target=changed)


class IntensityCompression(Known):
    """The reported intensity is a power of the true one, and saturates; detection does not know."""

    name, swept, weak, strong, two_sided = "intensity_compression", "exponent", 0.001, 1.0, True

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"saturation": np.inf} if rng.random() < 0.7 else {"exponent": 1.0}

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        if "exponent" in fixed:
            return cls({"saturation": float(0.9 * (0.02 / 0.9) ** abs(strength)), **fixed})
        size = cls.weak * (cls.strong / cls.weak) ** abs(strength)
        return cls({"exponent": float(1.0 / (1.0 + size)) if strength > 0 else float(1.0 + size), **fixed})

    def on_report(self, shot: Shot, report: Report) -> None:
        bent = np.where(report.kind == NO_ECHO, 0.0, report.intensity ** self.parameters["exponent"])
        report.intensity = np.minimum(bent, self.parameters["saturation"])


class RangeStretch(Known):
    """Detours by multiple scattering: a gamma draw of mean m x depth and half as much scatter (obvious: the mean)."""

    name, swept, weak, strong = "range_stretch", "m_per_optical_depth", 0.001, 3.0
    same_form = False

    def on_report(self, shot: Shot, report: Report) -> None:
        every = np.arange(shot.shape[0])[:, None]
        detour = self.value * shot.depth(every, report.range_m) * shot.rng.gamma(4.0, 0.25, shot.shape)
        report.range_m = np.where(report.range_m > 0.0, report.range_m + detour, 0.0)


class Crosstalk(Known):
    """Another laser's pulse, at any time, instead of the beam's own return."""

    name, swept, weak, strong = "crosstalk", "probability", 2e-5, 0.2

    def on_report(self, shot: Shot, report: Report) -> None:
        hit = shot.rng.random(shot.shape) < self.value
        low, high = max(shot.sensor.min_range_m, 0.5), shot.sensor.max_range_m
        at = shot.rng.uniform(low, high, shot.shape)
        signal = shot.sensor.threshold_per_m2_sr * _power(shot.rng.exponential(3.0, shot.shape))
        report.range_m = np.where(hit, at, report.range_m)
        report.signal = np.where(hit, signal, report.signal)
        report.intensity = np.where(hit, np.pi * signal * at**2, report.intensity)
        report.kind = np.where(hit, OTHER, report.kind)


class ParticleBackscatter(Known):
    """Drops, flakes or droplets shine brighter or weaker than the weather's own."""

    name, swept, weak, strong, two_sided = "particle_backscatter", "gain_db", 0.02, 8.0, True

    def prepare(self, shot: Shot) -> None:
        shot.highest_particle_gain *= max(1.0, float(_power(self.value)))

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        echoes.signal = np.where(echoes.kind == PARTICLE, echoes.signal * _power(self.value), echoes.signal)


class SectorLoss(Known):
    """Dirt that thins out to the sides like a bell (the obvious form: a sector with sharp edges)."""

    name, swept, weak, strong = "sector_loss", "loss_db", 0.02, 15.0
    same_form = False

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"azimuth_rad": float(rng.uniform(-np.pi, np.pi)), "width_rad": float(rng.uniform(0.4, 1.2))}

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        offset = _turn(shot.view.scan.azimuth_rad - self.parameters["azimuth_rad"]) / (
            0.5 * self.parameters["width_rad"]
        )
        # Half the loss at the sector's nominal edges.
        _scale_all(echoes, _power(-self.value * np.exp(-np.log(2.0) * offset**4)))


class PatchyWeather(Known):
    """The number of particles, and with it the extinction, differs from frame to frame."""

    name, swept, weak, strong = "patchy_weather", "log_std", 0.01, 1.5
    differs = True

    def prepare(self, shot: Shot) -> None:
        draw = shot.rng.standard_normal(shot.shape[0])
        shot.density = shot.density * np.exp(self.value * draw - 0.5 * self.value**2)


class Spray(Known):
    """A plume behind a wheel: bell-shaped in azimuth, log-normal in range (the obvious form: a sector, exponential)."""

    name, swept, weak, strong = "spray", "strength", 0.0005, 2.0
    same_form = False
    middle_m, log_spread = 4.5, 0.35

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"azimuth_rad": float(rng.uniform(-np.pi, np.pi)), "width_rad": float(rng.uniform(0.3, 0.9))}

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        offset = _turn(shot.view.scan.azimuth_rad - self.parameters["azimuth_rad"]) / (
            0.5 * self.parameters["width_rad"]
        )
        mean = self.value * np.exp(-0.5 * (1.5 * offset) ** 2) * (shot.view.scan.direction.reshape(-1, 3)[:, 2] < 0.1)
        count = shot.rng.poisson(np.broadcast_to(mean, shot.shape))
        frame, beam = np.nonzero(count)
        each = count[frame, beam]
        frame, beam = np.repeat(frame, each), np.repeat(beam, each)
        at = self.middle_m * np.exp(self.log_spread * shot.rng.standard_normal(len(beam)))
        signal = shot.sensor.threshold_per_m2_sr * _power(shot.rng.exponential(4.0, len(beam)))
        keep = (at < shot.view.target.range_m[beam]) & (at > shot.sensor.near_start_m)
        echoes.add(frame[keep], beam[keep], at[keep], signal[keep], PARTICLE)


class RingGain(Known):
    """The gain rises or falls from ring to ring."""

    name, swept, weak, strong, two_sided = "ring_gain", "db_per_ring", 0.0003, 0.3, True

    def prepare(self, shot: Shot) -> None:
        shot.highest_particle_gain *= float(_power(0.5 * shot.view.scan.shape[0] * abs(self.value)))

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        rings = shot.view.scan.shape[0]
        _scale_all(echoes, _power(self.value * (shot.view.scan.ring - 0.5 * (rings - 1))))


CATALOGUE: dict[str, type[Known]] = {
    f"lidar.{effect.name}": effect
    for effect in (
        *(BeamDivergence, IsolatedReturnFilter, ThresholdShift, WindowLoss, ExtinctionScale, WetTarget, BlindZone),
        *(RangeNoise, RangeBias, LimitedExtent, LastReturn, StaticStructure, IntensityCompression, RangeStretch),
        *(Crosstalk, ParticleBackscatter, SectorLoss, PatchyWeather, Spray, RingGain),
    )
}
"""By the catalogue's name, in its order."""
