"""Effects in the form in which recordings show them, and sensors as they are: studies in which a form was measured.

Density by azimuth and by elevation is that of the share of beams with a flake in two frames of WADS
(docs/lidar-snow-structure.md, "Frames 2 and 3 together"). The near-range response is that of an OS2-128,
``(R / 30 m)^2`` (PHYSICS.md 10.13). Three more are properties of a sensor or of its files that clear frames have as
well: nothing is missing then, and nothing may be named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .decoys import Decoy, Parameters
from .design import Design
from .known import Known, turn
from .lidar_shot import Effect, Report, Shot, View
from .rays import Scan, cast
from .scene import FloatArray

__all__ = ["MEASURED", "MEASURED_NULLS"]

# Beams with a flake by azimuth, every 45 degrees from -135, and by elevation between edges in degrees; shares.
SHARE_BY_AZIMUTH = (0.235, 0.189, 0.058, 0.322, 0.133, 0.130, 0.208, 0.360)
SHARE_BY_ELEVATION = (0.346, 0.429, 0.351, 0.181, 0.221, 0.157)
ELEVATION_EDGES_DEG = (-3.0, -1.5, 0.0, 1.5, 3.0, 9.0, 16.0)
FULL_M = 30.0  # range from which an OS2-128 takes all of the light
# KITTI's readings are hundredths; elevations of a table of an HDL-64E are off by as much (order of magnitude).
INTENSITY_STEP, ELEVATION_OFF_DEG = 0.01, 0.15
DARK_FROM_M = 12.0  # range from which wet asphalt sends nothing back to a sensor at a car's height (order of magnitude)

MakesDecoy = Callable[[Design, Parameters, np.random.Generator], Decoy]


def _number(share: tuple[float, ...]) -> FloatArray:
    """Expected number of flakes in a beam with so many chances of one: ``-ln(1 - share)``."""
    return -np.log1p(-np.asarray(share))


class NearResponse(Known):
    """The receiver takes ``(R / 30 m)^power`` of the light of particles; objects stay."""

    name, swept, weak, strong = "near_response", "power", 0.01, 2.0

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"full_m": FULL_M}

    def prepare(self, shot: Shot) -> None:
        shot.near_full_m, shot.near_power = self.parameters["full_m"], self.value


class DensityAzimuth(Known):
    """Flakes around a car as WADS has them (the obvious form: one lobe, and a first harmonic).

    ``amplitude`` of 1 is the recorded profile, which has a mean of 1; 0 is none.
    """

    name, swept, weak, strong = "particle_density_azimuth", "amplitude", 0.01, 1.0
    same_form = False

    @classmethod
    def fixed(cls, rng: np.random.Generator) -> dict[str, float]:
        return {"azimuth_rad": float(rng.uniform(-np.pi, np.pi))}  # of the car's rear, wherever the sensor's zero is

    def prepare(self, shot: Shot) -> None:
        number = _number(SHARE_BY_AZIMUTH)
        around = np.radians(np.arange(-135.0, 181.0, 45.0))
        at = turn(shot.view.scan.azimuth_rad - self.parameters["azimuth_rad"] + np.pi)
        profile = np.interp(at, around, number / number.mean(), period=2.0 * np.pi)
        shot.beam_density = 1.0 + self.value * (profile - 1.0)


class DensityElevation(Known):
    """More flakes in beams about the horizon as WADS has them (the obvious form: one lobe).

    ``amplitude`` of 1 is the recorded profile over that of the highest beams; 0 is none.
    """

    name, swept, weak, strong = "particle_density_elevation", "amplitude", 0.01, 1.0
    same_form = False

    def prepare(self, shot: Shot) -> None:
        number = _number(SHARE_BY_ELEVATION)
        edges = np.asarray(ELEVATION_EDGES_DEG)
        elevation = np.degrees(np.arcsin(shot.view.scan.direction.reshape(-1, 3)[:, 2]))
        profile = np.interp(elevation, 0.5 * (edges[1:] + edges[:-1]), number / number[-1])
        shot.beam_density = 1.0 + self.value * (profile - 1.0)


class _IntensityInSteps(Effect):
    """A reading in whole steps, the lowest of which is read as 0."""

    def on_output(self, report: Report) -> None:
        report.intensity = np.floor(report.intensity / INTENSITY_STEP) * INTENSITY_STEP


class _NoReturnFromTheGround(Effect):
    """Dark, wet ground far off returns nothing: beams that count as empty end there."""

    def on_view(self, view: View) -> View:
        far = (np.nan_to_num(view.target.up) > 0.5) & (view.target.range_m > DARK_FROM_M)
        return replace(view, target=replace(view.target, reflectivity=np.where(far, 1e-6, view.target.reflectivity)))


def _in_clear_too(effect: Effect) -> MakesDecoy:
    return lambda design, at, rng: Decoy(("none",), (), (effect,), (effect,))


def _elevations_off(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    """The table of elevations that the study states is off, ring by ring: frames are those of the true ones."""
    off = np.radians(ELEVATION_OFF_DEG) * rng.standard_normal(design.scan.shape[0])
    azimuth = np.arctan2(design.scan.direction[..., 1], design.scan.direction[..., 0])
    elevation = np.arcsin(design.scan.direction[..., 2]) + off[:, None]
    level = np.cos(elevation)
    direction = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1)
    scan = Scan(design.scan.elevation_deg, direction)
    views = tuple(
        replace(view, scan=scan, target=cast(view.scene, scan, view.sensor.max_range_m)) for view in design.views
    )
    return Decoy(("none",), views=views, clear_views=views)


MEASURED: dict[str, type[Known]] = {
    f"lidar.{effect.name}": effect for effect in (NearResponse, DensityAzimuth, DensityElevation)
}
"""By the catalogue's name."""

MEASURED_NULLS: dict[str, MakesDecoy] = {
    "measured.intensity_in_steps": _in_clear_too(_IntensityInSteps()),
    "measured.elevations_off": _elevations_off,
    "measured.empty_beams_end_at_ground": _in_clear_too(_NoReturnFromTheGround()),
}
"""By name; the right answer is that nothing is missing."""
