"""The effects of the catalogue in code of their own, five of thirteen in another form than the catalogue's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import polygamma

from .radar_sensor import CLASSES, Effect, Report, Shot, pattern_db, reflectivity

__all__ = ["CATALOGUE", "Known"]


@dataclass
class Known(Effect):
    """An effect with its parameters.

    ``swept`` is the parameter that sets its strength, ``weak`` and ``strong`` the ends between which the strength is
    looked for; ``fixed`` draws the others.
    """

    parameters: dict[str, float]
    name: ClassVar[str] = ""
    same_form: ClassVar[bool] = True
    swept: ClassVar[str] = ""
    weak: ClassVar[float] = 0.0
    strong: ClassVar[float] = 0.0
    two_sided: ClassVar[bool] = False

    @property
    def value(self) -> float:
        """The swept parameter."""
        return self.parameters[self.swept]

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        """The parameters that are not swept, drawn."""
        return {}

    @classmethod
    def size(cls, strength: float) -> float:
        """Of the swept parameter at a strength of 0 to 1 (-1 to 1 where both signs have a meaning)."""
        return float(np.sign(strength) * cls.weak * (cls.strong / cls.weak) ** abs(strength))

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        """The effect at a strength."""
        return cls({cls.swept: cls.size(strength), **fixed})


class WetRadome(Known):
    """A standing film on the cover."""

    name, swept, weak, strong = "wet_radome", "loss_db", 0.03, 10.0

    def on_path(self, shot: Shot) -> None:
        shot.gain_db -= self.value


class VolumeClutter(Known):
    """Cells of rain or snow above the threshold, range bin by range bin (PHYSICS.md 6.5)."""

    name, swept, weak, strong = "volume_clutter", "share", 1e-4, 10.0
    patches: ClassVar[int] = 300

    def on_path(self, shot: Shot) -> None:
        if shot.weather.kind not in ("rain", "snow"):
            return
        radar, rng = shot.radar, shot.rng
        eta, fall, fall_std = reflectivity(shot.weather)
        element = np.radians([radar.azimuth_beamwidth_deg, radar.elevation_beamwidth_deg])
        # A full grid of 32 x 6 virtual elements half a wavelength apart: half-power width 0.886 * 2 / n.
        array = 2.0 * 0.886 / np.array([32.0, 6.0])
        width = 1.0 / np.sqrt(2.0 / element**2 + 1.0 / array**2)
        step = radar.range_resolution_m
        range_m = np.arange(1.0, radar.max_range_m, step) + 0.5 * step
        volume = np.pi / (4.0 * np.log(2.0)) * width.prod() * range_m**2 * step
        beam = width / 2.3548
        tilt = np.sin(0.5 * element)
        spread = np.sqrt(0.25 + (fall_std * tilt[1]) ** 2 + (fall * beam[1]) ** 2)
        bins = max(1.0, np.sqrt(2.0 * np.pi) * spread / radar.speed_resolution_m_per_s)
        wavelength_m = 299792458.0 / 77e9
        constant = 12.0 + 24.0 + 20.0 * np.log10(wavelength_m) - 30.0 * np.log10(4.0 * np.pi)
        mean_db = constant + 10.0 * np.log10(self.value * eta * volume / bins) - 40.0 * np.log10(range_m)
        mean_db = mean_db - 2e-3 * shot.per_km * range_m
        view = np.minimum(2.0 * element, np.pi)
        azimuth, elevation = (rng.random((2, self.patches)) - 0.5) * view[:, None]
        loss_db = 2.0 * pattern_db(radar, azimuth, elevation)
        threshold = shot.floor_db.mean() + shot.threshold_db.mean()
        above = np.exp(-(10.0 ** (0.1 * (threshold - mean_db[:, None] - loss_db))))  # (bins, patches)
        cells = max(1.0, view.prod() / (np.pi / (4.0 * np.log(2.0)) * width.prod())) * bins
        expected = cells * above.mean(1)
        # A list has an end: at most 200 of them, a random share.
        expected = expected * min(1.0, 200.0 / max(expected.sum(), 1e-9))
        count = rng.poisson(expected, (len(shot.number), len(range_m)))
        frame, place = np.nonzero(count)
        repeats = count[frame, place]
        frame, place = np.repeat(frame, repeats), np.repeat(place, repeats)
        share = above[place].cumsum(1)
        patch = np.minimum((share < rng.random((len(place), 1)) * share[:, -1:]).sum(1), self.patches - 1)
        at = range_m[place] + (rng.random(len(place)) - 0.5) * step
        over = 10.0 ** (0.1 * (mean_db[place] + loss_db[patch] - threshold)) * rng.exponential(1.0, len(place))
        power = threshold + 10.0 * np.log10(1.0 + over)
        up = np.sin(elevation[patch])
        speed = -fall * up + np.sqrt(0.25 + (fall_std * up) ** 2) * rng.standard_normal(len(place))
        ambiguous = 2.0 * radar.max_speed_m_per_s
        speed = speed - ambiguous * np.round(speed / ambiguous)
        rows = np.stack([at, azimuth[patch], elevation[patch], speed, power, np.full(len(at), 0.5)], 1)
        shot.clutter.append((rows, frame))


class NoiseFloor(Known):
    """A receiver that is noisier, or less so."""

    name, swept, weak, strong, two_sided = "noise_floor", "shift_db", 0.005, 8.0, True

    def on_path(self, shot: Shot) -> None:
        shot.floor_db = shot.floor_db + self.value


class CfarShift(Known):
    """Each cell asks for its own SNR, 1 dB about a mean that is higher (the obvious form: the same for all)."""

    name, swept, weak, strong = "cfar_shift", "shift_db", 0.1, 12.0
    same_form = False

    def on_path(self, shot: Shot) -> None:
        own = np.random.default_rng(17).standard_normal(shot.shape[1])
        shot.threshold_db = shot.threshold_db + np.maximum(self.value + min(1.0, 0.3 * self.value) * own, 0.0)


class PathLossScale(Known):
    """Drops of other sizes than the law's."""

    name, swept, weak, strong, two_sided = "path_loss_scale", "factor", 0.02, 3.0, True

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        return cls({"factor": float((1.0 + abs(cls.size(strength))) ** np.sign(strength))})

    def on_path(self, shot: Shot) -> None:
        shot.per_km *= self.value


class Multipath(Known):
    """Each target has a second path of its own strength (the obvious form: the same for all)."""

    name, swept, weak, strong = "multipath", "amplitude", 0.002, 0.9
    same_form = False

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"delay_m": float(rng.uniform(2.0, 12.0))}

    def on_report(self, shot: Shot, report: Report) -> None:
        delay_m = self.parameters["delay_m"]
        targets = shot.targets
        own = np.exp(0.15 * np.random.default_rng(23).standard_normal(shot.shape[1]))
        fainter = 20.0 * np.log10(np.minimum(self.value * own, 1.0)) - 2e-3 * shot.per_km * delay_m
        power = report.power_db + fainter
        there = power >= shot.floor_db[:, None] + shot.threshold_db  # NaN is false
        frame, place = np.nonzero(there)
        angle = 0.003 * shot.rng.standard_normal((2, len(frame)))
        rows = np.stack(
            [
                report.range_m[frame, place] + delay_m + 0.05 * shot.rng.standard_normal(len(frame)),
                targets.azimuth_rad[place] + angle[0],
                targets.elevation_rad[place] + angle[1],
                report.speed_m_per_s[frame, place],
                power[frame, place],
                np.zeros(len(frame)),
            ],
            1,
        )
        report.clutter = np.concatenate([report.clutter, rows])
        report.clutter_frame = np.concatenate([report.clutter_frame, frame])


class DopplerSpread(Known):
    """Speeds with errors of Laplace's law (the obvious form: a normal one)."""

    name, swept, weak, strong = "doppler_spread", "std_m_per_s", 0.003, 2.0
    same_form = False

    def on_report(self, shot: Shot, report: Report) -> None:
        scale = self.value / np.sqrt(2.0)
        report.speed_m_per_s = report.speed_m_per_s + shot.rng.laplace(0.0, scale, shot.shape)


class WetRcs(Known):
    """Some classes reflect more or less when wet."""

    name, swept, weak, strong, two_sided = "wet_rcs", "gain", 0.05, 8.0, True

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        first, second = rng.choice(len(CLASSES), 2, replace=False)
        return {f"weight_{first}": 1.0, f"weight_{second}": float(rng.uniform(-0.6, 0.6))}

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        size = cls.size(strength)
        return cls({f"gain_db_{k}": size * fixed.get(f"weight_{k}", 0.0) for k in range(len(CLASSES))})

    def on_path(self, shot: Shot) -> None:
        gain = np.array([self.parameters[f"gain_db_{k}"] for k in range(len(CLASSES))])
        shot.gain_db += gain[shot.targets.target_class.astype(int)]


class Interference(Known):
    """Frames that an interferer hits, by another level each (the obvious form: the same level)."""

    name, swept, weak, strong = "interference", "level_db", 0.05, 25.0
    same_form = False

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"probability": float(rng.uniform(0.25, 0.6))}

    def on_path(self, shot: Shot) -> None:
        hit = shot.rng.random(len(shot.number)) < self.parameters["probability"]
        level = self.value * np.exp(0.15 * shot.rng.standard_normal(len(hit)))
        shot.floor_db = shot.floor_db + np.where(hit, level, 0.0)


class RangeMigration(Known):
    """Ranges that drift from frame to frame."""

    name, swept, weak, strong, two_sided = "range_migration", "m_per_frame", 1e-4, 0.5, True

    def on_report(self, shot: Shot, report: Report) -> None:
        drift = self.value * shot.number
        report.range_m = np.maximum(report.range_m + drift[:, None], 0.0)
        report.clutter[:, 0] = np.maximum(report.clutter[:, 0] + drift[report.clutter_frame], 0.0)


class PatternTilt(Known):
    """A bent mount."""

    name, swept, weak, strong, two_sided = "pattern_tilt", "angle_rad", 5e-4, 0.4, True

    def on_path(self, shot: Shot) -> None:
        targets = shot.targets
        turned = pattern_db(shot.radar, targets.azimuth_rad - self.value, targets.elevation_rad)
        shot.gain_db += 2.0 * (turned - pattern_db(shot.radar, targets.azimuth_rad, targets.elevation_rad))


class Fluctuation(Known):
    """Powers of a gamma law (the obvious form: log-normal)."""

    name, swept, weak, strong = "fluctuation", "log_std_db", 0.05, 8.0
    same_form = False

    def on_path(self, shot: Shot) -> None:
        per_neper = 10.0 / np.log(10.0)
        shapes = np.exp(np.linspace(np.log(0.2), np.log(2e4), 400))
        spread = per_neper * np.sqrt(polygamma(1, shapes))
        shape = float(np.exp(np.interp(-self.value, -spread, np.log(shapes))))
        shot.gain_db += 10.0 * np.log10(np.maximum(shot.rng.gamma(shape, 1.0 / shape, shot.shape), 1e-9))


class DetectionLimit(Known):
    """A list that is full: the strongest stay."""

    name, swept, weak, strong = "detection_limit", "max_count", 300.0, 10.0

    @classmethod
    def at(cls, strength: float, fixed: Mapping[str, float]) -> Known:
        return cls({"max_count": float(np.round(cls.size(strength)))})

    def on_report(self, shot: Shot, report: Report) -> None:
        keep_others = np.ones(len(report.clutter), dtype=bool)
        lost = np.zeros(shot.shape, dtype=bool)
        for k in range(len(shot.number)):
            own = np.flatnonzero(report.clutter_frame == k)
            power = np.concatenate([np.nan_to_num(report.power_db[k], nan=-1e9), report.clutter[own, 4]])
            weakest = np.argsort(-power)[int(self.value) :]
            lost[k, weakest[weakest < shot.shape[1]]] = True
            keep_others[own[weakest[weakest >= shot.shape[1]] - shot.shape[1]]] = False
        report.drop(lost)
        report.clutter, report.clutter_frame = report.clutter[keep_others], report.clutter_frame[keep_others]


CATALOGUE: dict[str, type[Known]] = {
    f"radar.{effect.name}": effect
    for effect in (
        *(WetRadome, VolumeClutter, NoiseFloor, CfarShift, PathLossScale, Multipath, DopplerSpread, WetRcs),
        *(Interference, RangeMigration, PatternTilt, Fluctuation, DetectionLimit),
    )
}
"""By name."""
