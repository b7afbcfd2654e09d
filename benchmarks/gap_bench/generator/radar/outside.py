"""Effects that are not in the catalogue: the right answer is that something unknown is there, and along which axis."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from .effects import Known
from .radar_sensor import Report, Shot

__all__ = ["OUTSIDE", "Outside"]


class Outside(Known):
    """An effect outside of the catalogue; ``shows_along`` are words of the axes that count as right."""

    same_form = False
    shows_along: ClassVar[tuple[str, ...]] = ()


class RangeGainStep(Outside):
    """The gain steps down where the receiver switches to another range."""

    name, swept, weak, strong, shows_along = "range_gain_step", "loss_db", 0.05, 10.0, ("range",)

    def on_path(self, shot: Shot) -> None:
        shot.gain_db -= np.where(shot.targets.range_m > 35.0, self.value, 0.0)


class DopplerAliasing(Outside):
    """Some speeds appear an ambiguity too high."""

    name, swept, weak, strong, shows_along = "doppler_aliasing", "probability", 5e-4, 0.8, ("any",)

    def on_report(self, shot: Shot, report: Report) -> None:
        moving = shot.targets.speed_m_per_s > 0.3
        folded = moving & (shot.rng.random(shot.shape) < self.value)
        report.speed_m_per_s = report.speed_m_per_s - np.where(folded, 2.0 * shot.radar.max_speed_m_per_s, 0.0)


class DroppedChirps(Outside):
    """Frames that lost chirps: all powers lower, the floor as it was."""

    name, swept, weak, strong, shows_along = "dropped_chirps", "loss_db", 0.1, 12.0, ("frame", "any")

    def on_path(self, shot: Shot) -> None:
        hit = shot.rng.random(len(shot.number)) < 0.4
        shot.gain_db -= np.where(hit, self.value, 0.0)[:, None]


class AzimuthRipple(Outside):
    """A bumper: powers rise and fall over the azimuth."""

    name, swept, weak, strong, shows_along = "azimuth_ripple", "ripple_db", 0.05, 8.0, ("azimuth",)

    def on_path(self, shot: Shot) -> None:
        shot.gain_db += self.value * np.cos(2.0 * np.pi * shot.targets.azimuth_rad / 0.7)


class QuantisedPower(Outside):
    """Powers in coarse steps."""

    name, swept, weak, strong, shows_along = "quantised_power", "step_db", 0.05, 20.0, ("any",)

    def on_report(self, shot: Shot, report: Report) -> None:
        report.power_db = np.floor(report.power_db / self.value) * self.value


class MissingClass(Outside):
    """Targets of one class are filtered away, now and then."""

    name, swept, weak, strong, shows_along = "missing_class", "probability", 5e-3, 0.95, ("class",)

    def on_report(self, shot: Shot, report: Report) -> None:
        report.drop((shot.targets.target_class == 1) & (shot.rng.random(shot.shape) < self.value))


class PowerCompression(Outside):
    """Strong echoes read too low, as of a receiver near saturation."""

    name, swept, weak, strong, shows_along = "power_compression", "share", 0.0005, 0.8, ("margin", "range")

    def on_report(self, shot: Shot, report: Report) -> None:
        knee = shot.floor_db[:, None] + 30.0
        report.power_db = report.power_db - self.value * np.maximum(report.power_db - knee, 0.0)


class ElevationSag(Outside):
    """High targets fade: ice on the upper edge of the cover."""

    name, swept, weak, strong, shows_along = "elevation_sag", "db_per_rad", 0.5, 150.0, ("elevation",)

    def on_path(self, shot: Shot) -> None:
        shot.gain_db -= self.value * np.maximum(shot.targets.elevation_rad, 0.0)


OUTSIDE: dict[str, type[Outside]] = {
    f"outside.{effect.name}": effect
    for effect in (
        *(RangeGainStep, DopplerAliasing, DroppedChirps, AzimuthRipple, QuantisedPower, MissingClass),
        *(PowerCompression, ElevationSag),
    )
}
"""By name."""
