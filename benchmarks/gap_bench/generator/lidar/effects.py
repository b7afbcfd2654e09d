"""The twenty effects of the catalogue in code of their own; nine of them in another form than the obvious one.

Names and parameters are those of the catalogue. Where ``same_form`` is false the parameter is the one that comes
nearest: the middle of a soft edge, the level at which a film saturates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from .known import Known, power, scale_all, turn
from .lidar_shot import NO_ECHO, OTHER, Echoes, Report, Shot, View
from .particle_effects import (
    BeamDivergence,
    ExtinctionScale,
    IsolatedReturnFilter,
    LastReturn,
    LimitedExtent,
    ParticleBackscatter,
    PatchyWeather,
    Spray,
)
from .rays import Target

__all__ = ["CATALOGUE"]


class ThresholdShift(Known):
    """The detection threshold is another one."""

    name, swept, weak, strong, two_sided = "threshold_shift", "shift_db", 0.01, 8.0, True

    def prepare(self, shot: Shot) -> None:
        shot.threshold_gain = shot.threshold_gain * power(self.value)


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
        scale_all(echoes, np.full(shot.shape[1], power(-self.value * share)))


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
        offset = np.abs(turn(scan.azimuth_rad - self.parameters["azimuth_rad"])) / (0.5 * self.value)
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
        signal = shot.sensor.threshold_per_m2_sr * power(shot.rng.exponential(3.0, shot.shape))
        report.range_m = np.where(hit, at, report.range_m)
        report.signal = np.where(hit, signal, report.signal)
        report.intensity = np.where(hit, np.pi * signal * at**2, report.intensity)
        report.kind = np.where(hit, OTHER, report.kind)


class SectorLoss(Known):
    """Dirt that thins out to the sides like a bell (the obvious form: a sector with sharp edges)."""

    name, swept, weak, strong = "sector_loss", "loss_db", 0.02, 15.0
    same_form = False

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"azimuth_rad": float(rng.uniform(-np.pi, np.pi)), "width_rad": float(rng.uniform(0.4, 1.2))}

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        offset = turn(shot.view.scan.azimuth_rad - self.parameters["azimuth_rad"]) / (
            0.5 * self.parameters["width_rad"]
        )
        # Half the loss at the sector's nominal edges.
        scale_all(echoes, power(-self.value * np.exp(-np.log(2.0) * offset**4)))


class RingGain(Known):
    """The gain rises or falls from ring to ring."""

    name, swept, weak, strong, two_sided = "ring_gain", "db_per_ring", 0.0003, 0.3, True

    def prepare(self, shot: Shot) -> None:
        shot.highest_particle_gain *= float(power(0.5 * shot.view.scan.shape[0] * abs(self.value)))

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        rings = shot.view.scan.shape[0]
        scale_all(echoes, power(self.value * (shot.view.scan.ring - 0.5 * (rings - 1))))


CATALOGUE: dict[str, type[Known]] = {
    f"lidar.{effect.name}": effect
    for effect in (
        *(BeamDivergence, IsolatedReturnFilter, ThresholdShift, WindowLoss, ExtinctionScale, WetTarget, BlindZone),
        *(RangeNoise, RangeBias, LimitedExtent, LastReturn, StaticStructure, IntensityCompression, RangeStretch),
        *(Crosstalk, ParticleBackscatter, SectorLoss, PatchyWeather, Spray, RingGain),
    )
}
"""By the catalogue's name, in its order."""
