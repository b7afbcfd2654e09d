"""Effects of the catalogue on what is in the air, in code of their own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .known import Known, power, turn
from .lidar_shot import PARTICLE, Echoes, Report, Shot


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


class ExtinctionScale(Known):
    """The path takes more or less than the weather's particles explain."""

    name, swept, weak, strong, two_sided = "extinction_scale", "factor", 0.005, 1.5, True

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        size = cls.weak * (cls.strong / cls.weak) ** abs(strength)
        return cls({"factor": float((1.0 + size) ** np.sign(strength))})

    def prepare(self, shot: Shot) -> None:
        shot.extinction_factor *= self.value


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


class ParticleBackscatter(Known):
    """Drops, flakes or droplets shine brighter or weaker than the weather's own."""

    name, swept, weak, strong, two_sided = "particle_backscatter", "gain_db", 0.02, 8.0, True

    def prepare(self, shot: Shot) -> None:
        shot.highest_particle_gain *= max(1.0, float(power(self.value)))

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        echoes.signal = np.where(echoes.kind == PARTICLE, echoes.signal * power(self.value), echoes.signal)


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
        offset = turn(shot.view.scan.azimuth_rad - self.parameters["azimuth_rad"]) / (
            0.5 * self.parameters["width_rad"]
        )
        mean = self.value * np.exp(-0.5 * (1.5 * offset) ** 2) * (shot.view.scan.direction.reshape(-1, 3)[:, 2] < 0.1)
        count = shot.rng.poisson(np.broadcast_to(mean, shot.shape))
        frame, beam = np.nonzero(count)
        each = count[frame, beam]
        frame, beam = np.repeat(frame, each), np.repeat(beam, each)
        at = self.middle_m * np.exp(self.log_spread * shot.rng.standard_normal(len(beam)))
        signal = shot.sensor.threshold_per_m2_sr * power(shot.rng.exponential(4.0, len(beam)))
        keep = (at < shot.view.target.range_m[beam]) & (at > shot.sensor.near_start_m)
        echoes.add(frame[keep], beam[keep], at[keep], signal[keep], PARTICLE)
