"""Effects that are not in the catalogue: the right answer is that something unknown is there, and along which axis."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from .known import Known
from .lidar_shot import NO_ECHO, OTHER, TARGET, Echoes, Report, Shot, View
from .rays import Scan, Target, cast
from .scene import SENSOR_HEIGHT_M, FloatArray

__all__ = ["OUTSIDE", "Outside"]


class Outside(Known):
    """An effect outside of the catalogue; ``shows_along`` are the axes that count as right."""

    same_form = False
    shows_along: ClassVar[tuple[str, ...]] = ()


def _moved(report: Report, offset_m: FloatArray | float) -> None:
    report.range_m = np.where(report.range_m > 0.0, np.maximum(report.range_m + offset_m, 0.01), 0.0)


def _turn_share(shot: Shot) -> FloatArray:
    """Place of each beam in the turn, -0.5..0.5."""
    return np.asarray(shot.view.scan.column / shot.view.scan.shape[1] - 0.5)


class RingDrift(Outside):
    """Ranges are too long in the upper rings and too short in the lower ones."""

    name, swept, weak, strong, shows_along = "ring_drift", "end_m", 0.002, 1.0, ("elevation",)

    def on_report(self, shot: Shot, report: Report) -> None:
        _moved(report, self.value * (1.0 - 2.0 * shot.view.scan.ring / (shot.view.scan.shape[0] - 1)))


class QuantisedRange(Outside):
    """Ranges come in coarse steps."""

    name, swept, weak, strong, shows_along = "quantised_range", "step_m", 0.02, 2.0, ("range",)

    def on_report(self, shot: Shot, report: Report) -> None:
        _moved(report, np.rint(report.range_m / self.value) * self.value - report.range_m)


class AzimuthRipple(Outside):
    """The gain rises and falls three times a turn."""

    name, swept, weak, strong, shows_along = "azimuth_ripple", "ripple_db", 0.02, 6.0, ("azimuth",)

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        gain = 10.0 ** (0.1 * self.value * np.cos(3.0 * shot.view.scan.azimuth_rad))
        echoes.target, echoes.signal = echoes.target * gain, echoes.signal * gain[echoes.beam]


class GhostEcho(Outside):
    """Strong near targets are reported at twice their range."""

    name, swept, weak, strong, shows_along = "ghost_echo", "probability", 5e-4, 0.8, ("range", "intensity")

    def on_report(self, shot: Shot, report: Report) -> None:
        bright = (report.kind == TARGET) & (report.signal > 30.0 * shot.sensor.threshold_per_m2_sr)
        ghost = bright & (shot.rng.random(shot.shape) < self.value)
        _moved(report, np.where(ghost, report.range_m, 0.0))
        report.intensity = np.where(ghost, 0.1 * report.intensity, report.intensity)


class IntensityQuantisation(Outside):
    """Intensities come in coarse steps, the lowest one being half a step."""

    name, swept, weak, strong, shows_along = "intensity_quantisation", "step", 0.002, 0.3, ("intensity", "range")

    def on_report(self, shot: Shot, report: Report) -> None:
        steps = np.maximum(np.rint(report.intensity / self.value), 0.5) * self.value
        report.intensity = np.where(report.range_m > 0.0, steps, 0.0)


class RollingRangeOffset(Outside):
    """The range offset grows along the turn."""

    name, swept, weak, strong, shows_along = "rolling_range_offset", "end_m", 0.002, 1.0, ("azimuth",)

    def on_report(self, shot: Shot, report: Report) -> None:
        _moved(report, 2.0 * self.value * _turn_share(shot))


class DeadRings(Outside):
    """Four rings lose part of their returns."""

    name, swept, weak, strong, shows_along = "dead_rings", "probability", 0.002, 1.0, ("elevation",)

    def on_report(self, shot: Shot, report: Report) -> None:
        rings = shot.view.scan.shape[0]
        dead = np.isin(shot.view.scan.ring, np.arange(rings // 3, rings // 3 + max(rings // 16, 2)))
        report.drop(dead & (shot.rng.random(shot.shape) < self.value))


class WetRoadMirror(Outside):
    """A wet road reflects beams that graze it: what stands beyond appears below the ground."""

    name, swept, weak, strong, shows_along = "wet_road_mirror", "share", 0.002, 1.0, ("range", "incidence", "elevation")

    def on_view(self, view: View) -> View:
        target, scan = view.target, view.scan
        upward = scan.direction * np.array([1.0, 1.0, -1.0])
        seen = cast(view.scene, Scan(scan.elevation_deg, upward), view.sensor.max_range_m, -SENSOR_HEIGHT_M)
        grazing = (np.nan_to_num(target.up) > 0.5) & (np.nan_to_num(target.cos_incidence, nan=1.0) < 0.2)
        wet = np.random.default_rng(7).random(view.beams) < self.value  # the same puddles in every frame
        hit = grazing & wet & (seen.range_m > target.range_m)
        changed = Target(
            np.where(hit, seen.range_m, target.range_m),
            np.where(hit, 0.5 * seen.reflectivity, target.reflectivity),
            np.where(hit, seen.cos_incidence, target.cos_incidence),
            np.where(hit, seen.up, target.up),
        )
        return replace(view, target=changed)


class ThresholdRamp(Outside):
    """The threshold rises along the turn as the receiver warms up."""

    name, swept, weak, strong, shows_along = "threshold_ramp", "end_db", 0.02, 8.0, ("azimuth",)

    def prepare(self, shot: Shot) -> None:
        shot.threshold_gain = shot.threshold_gain * 10.0 ** (0.2 * self.value * _turn_share(shot))[None, :]


class PointingJitter(Outside):
    """Rings look a column further in some frames."""

    name, swept, weak, strong, shows_along = (
        "pointing_jitter",
        "probability",
        0.002,
        0.9,
        ("range", "frame", "elevation"),
    )

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        rings, columns = shot.view.scan.shape
        frames = shot.shape[0]
        turned = np.repeat(shot.rng.random((frames, rings)) < self.value, columns, axis=1)
        for name in ("target", "target_m"):
            values = getattr(echoes, name).reshape(frames, rings, columns)
            moved = np.roll(values, 1, axis=2).reshape(frames, -1)
            setattr(echoes, name, np.where(turned, moved, values.reshape(frames, -1)))


class RangeGainStep(Outside):
    """Another amplifier takes over at 18 m."""

    name, swept, weak, strong, shows_along = "range_gain_step", "step_db", 0.02, 6.0, ("range",)

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        gain = 10.0 ** (-0.1 * self.value)
        echoes.target = echoes.target * np.where(echoes.target_m > 18.0, gain, 1.0)
        echoes.signal = echoes.signal * np.where(echoes.range_m > 18.0, gain, 1.0)


class DoublePulse(Outside):
    """A second pulse follows the first; some targets are seen by it alone, a little too far away."""

    name, swept, weak, strong, shows_along = "double_pulse", "probability", 5e-4, 0.8, ("range",)

    def on_report(self, shot: Shot, report: Report) -> None:
        late = (report.kind == TARGET) & (shot.rng.random(shot.shape) < self.value)
        _moved(report, np.where(late, 2.4, 0.0))


class LostPackets(Outside):
    """Blocks of columns are missing, others in every frame."""

    name, swept, weak, strong, shows_along = "lost_packets", "probability", 2e-4, 0.5, ("azimuth", "frame")

    def on_report(self, shot: Shot, report: Report) -> None:
        block = (shot.view.scan.column * 32 / shot.view.scan.shape[1]).astype(int)
        lost = shot.rng.random((shot.shape[0], 32)) < self.value
        report.drop(lost[:, block])


class SunGlare(Outside):
    """Around the sun the background raises the threshold, and noise fires now and then."""

    name, swept, weak, strong, shows_along = "sun_glare", "rise_db", 0.05, 15.0, ("azimuth", "elevation")

    def _glare(self, shot: Shot) -> FloatArray:
        sun = np.array([np.cos(0.7), np.sin(0.7), 0.1])
        cosine = shot.view.scan.direction.reshape(-1, 3) @ (sun / np.linalg.norm(sun))
        return np.asarray(np.exp(-0.5 * (np.arccos(np.clip(cosine, -1.0, 1.0)) / 0.25) ** 2))

    def prepare(self, shot: Shot) -> None:
        shot.threshold_gain = shot.threshold_gain * 10.0 ** (0.1 * self.value * self._glare(shot))[None, :]

    def on_report(self, shot: Shot, report: Report) -> None:
        fires = (report.kind == NO_ECHO) & (shot.rng.random(shot.shape) < 2e-4 * self.value * self._glare(shot))
        at = shot.rng.uniform(0.5, shot.sensor.max_range_m, shot.shape)
        report.range_m = np.where(fires, at, report.range_m)
        report.intensity = np.where(fires, 0.05, report.intensity)
        report.kind = np.where(fires, OTHER, report.kind)


class IntensitySpeckle(Outside):
    """Intensities scatter more than in clear air, their mean unchanged."""

    name, swept, weak, strong, shows_along = "intensity_speckle", "log_std", 0.01, 0.8, ("range", "intensity", "any")

    def on_report(self, shot: Shot, report: Report) -> None:
        draw = shot.rng.standard_normal(shot.shape)
        report.intensity = report.intensity * np.exp(self.value * draw - 0.5 * self.value**2)


OUTSIDE: dict[str, type[Outside]] = {
    f"outside.{effect.name}": effect
    for effect in (
        *(RingDrift, QuantisedRange, AzimuthRipple, GhostEcho, IntensityQuantisation, RollingRangeOffset, DeadRings),
        *(WetRoadMirror, ThresholdRamp, PointingJitter, RangeGainStep, DoublePulse, LostPackets, SunGlare),
        IntensitySpeckle,
    )
}
"""By name."""
