"""Fields of a file with a radar detection's position, speed, power and cross section, and their conversion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import TorchweatherError

__all__ = ["POSITIONS", "RADIAL", "SPEEDS", "RadarColumns"]

Column = npt.NDArray[np.float64]
Columns = dict[str, Column]

# Names in lower case, in the order in which they are sought.
CARTESIAN = (("x_m", "y_m", "z_m"), ("x", "y", "z"))
SPHERICAL = tuple(
    ("range_m", f"azimuth_{azimuth}", f"elevation_{elevation}")
    for azimuth in ("rad", "deg")
    for elevation in ("rad", "deg")
)
POSITIONS = (*CARTESIAN, *SPHERICAL)
POWERS = ("power_dbm", "power_db")
CROSS_SECTIONS = ("rcs_dbsm", "rcs")
SPEED = "speed_m_per_s"
# View-of-Delft's radial speeds, m/s.
RADIAL = {"relative": "v_r", "compensated": "v_r_compensated"}
# Ground velocities in m/s, nuScenes' names: as the radar measures them, and less the car's own motion.
SPEEDS = {"relative": ("vx", "vy"), "compensated": ("vx_comp", "vy_comp")}
# Angles and roots come out differently in the last bits on another machine: fewer parts of the number are no change.
SAME = 8.0


@dataclass(frozen=True)
class RadarColumns:
    """Names, as a file has them, of the columns that the six numbers of a detection come from.

    Args:
        position: three names of one of `POSITIONS`.
        speed: one name of a radial speed, or the two of a velocity (forward, left).
        power: name of the power in dBm, ``None`` where there is none.
        rcs: name of the radar cross section in dBsm, ``None`` where there is none.
        velocities: pairs of names of velocities that a change of the speed goes into; empty where ``speed`` is one.
    """

    position: tuple[str, str, str]
    speed: tuple[str, ...]
    power: str | None
    rcs: str | None
    velocities: tuple[tuple[str, str], ...] = ()

    @classmethod
    def among(cls, names: Sequence[str], speed: str, source: Path) -> RadarColumns:
        """The columns that a detection needs, out of those of a file.

        Args:
            names: of the file's columns.
            speed: ``relative`` or ``compensated``, where the file holds velocities and no radial speed.
            source: the file, for errors.
        """
        lower = {name.lower(): name for name in reversed(names)}
        shown = ", ".join(names) or "none"
        positions = [group for group in POSITIONS if all(name in lower for name in group)]
        if not positions:
            raise TorchweatherError(
                f"{source}: expected a position, columns x_m, y_m, z_m (metres) or range_m, azimuth_rad or "
                f"azimuth_deg, elevation_rad or elevation_deg; got {shown}. A radar without elevation has a column of "
                "zeros."
            )
        x, y, z = (lower[name] for name in positions[0])
        velocities: tuple[tuple[str, str], ...] = ()
        if SPEED in lower:
            speeds: tuple[str, ...] = (lower[SPEED],)
        elif RADIAL.get(speed) in lower:
            speeds = (lower[RADIAL[speed]],)
        else:
            pairs = {key: (lower[a], lower[b]) for key, (a, b) in SPEEDS.items() if a in lower and b in lower}
            if speed not in pairs:
                raise TorchweatherError(
                    f"{source}: expected a speed, a column {SPEED} (radial, positive when receding) or "
                    f"{' and '.join(SPEEDS[speed])} (m/s, speed={speed!r}); got {shown}."
                )
            speeds, velocities = pairs[speed], tuple(pairs.values())
        power, rcs = (
            next((lower[name] for name in known if name in lower), None) for known in (POWERS, CROSS_SECTIONS)
        )
        if power is None and rcs is None:
            raise TorchweatherError(
                f"{source}: expected a power (power_dbm, power_db) or a radar cross section (rcs_dbsm, rcs), of which "
                f"one gives the other; got {shown}."
            )
        return cls((x, y, z), speeds, power, rcs, velocities)

    @property
    def spherical(self) -> bool:
        """True where the position is range, azimuth and elevation."""
        return self.position[0].lower() == "range_m"

    @property
    def direct(self) -> dict[str, int]:
        """Columns that a detection holds as they are, with their place among its six numbers."""
        places = dict(zip(self.position, range(3), strict=True)) if not self.spherical else {}
        if len(self.speed) == 1:
            places[self.speed[0]] = 3
        places |= {name: place for name, place in ((self.power, 4), (self.rcs, 5)) if name is not None}
        return places

    def position_m(self, found: Columns) -> Column:
        """``(N, 3)`` x forward, y left, z up of a file's columns."""
        first, second, third = (found[name] for name in self.position)
        if not self.spherical:
            return np.stack([first, second, third], axis=1)
        azimuth, elevation = (
            np.deg2rad(angle) if name.lower().endswith("_deg") else angle
            for name, angle in zip(self.position[1:], (second, third), strict=True)
        )
        flat = first * np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), first * np.sin(elevation)], axis=1)

    def speed_m_per_s(self, found: Columns, position_m: Column) -> Column:
        """``(N,)`` radial speed of a file's columns, positive when receding: ``(x vx + y vy) / r``."""
        if len(self.speed) == 1:
            return found[self.speed[0]]
        range_m = np.sqrt(np.square(position_m).sum(axis=1))
        forward, left = (found[name] for name in self.speed)
        toward = position_m[:, 0] * forward + position_m[:, 1] * left
        return np.where(range_m == 0, 0.0, toward / np.where(range_m == 0, 1.0, range_m))

    def stored(self, six: Column, found: Columns, epsilon: float) -> Columns:
        """The file's columns for detections that may have changed.

        Columns that a detection holds as they are take its numbers. Range and angles, and velocities, are kept where
        they still give the position and the speed; else the velocities change along the line of sight.

        Args:
            six: ``(N, 6)`` the detections.
            found: the file's other columns, as they were.
            epsilon: relative step of the numbers the detections are held in.
        """
        columns = dict(found) | {name: six[:, place] for name, place in self.direct.items()}
        position_m, speed = six[:, :3], six[:, 3]
        if self.spherical:
            columns |= self._moved(position_m, columns, epsilon)
        if self.velocities:
            columns |= self._accelerated(position_m, speed, columns, epsilon)
        return columns

    def _moved(self, position_m: Column, columns: Columns, epsilon: float) -> Columns:
        range_m = np.sqrt(np.square(position_m).sum(axis=1))
        before = self.position_m(columns)
        kept = _same(position_m, before, epsilon * range_m[:, None]).all(axis=1)
        flat = np.hypot(position_m[:, 0], position_m[:, 1])
        spherical = [range_m, np.arctan2(position_m[:, 1], position_m[:, 0]), np.arctan2(position_m[:, 2], flat)]
        moved = {}
        for name, value in zip(self.position, spherical, strict=True):
            unit = np.rad2deg(value) if name.lower().endswith("_deg") else value
            moved[name] = np.where(kept, columns[name], unit)
        return moved

    def _accelerated(self, position_m: Column, speed: Column, columns: Columns, epsilon: float) -> Columns:
        forward, left = (columns[name] for name in self.speed)
        before = self.speed_m_per_s(columns, position_m)
        kept = _same(speed, before, epsilon * (np.abs(speed) + np.hypot(forward, left)))
        flat_square = np.square(position_m[:, :2]).sum(axis=1)
        # A velocity along the ground that adds this much along the line of sight; none is seen straight above.
        share = (
            (speed - before) * np.sqrt(np.square(position_m).sum(axis=1)) / np.where(flat_square > 0, flat_square, 1)
        )
        changed = {}
        for pair in self.velocities:
            for name, axis in zip(pair, (0, 1), strict=True):
                changed[name] = np.where(kept, columns[name], columns[name] + share * position_m[:, axis])
        return changed


def _same(new: Column, before: Column, step: Column) -> npt.NDArray[np.bool_]:
    same: npt.NDArray[np.bool_] = np.abs(new - before) <= SAME * step
    return same | (np.isnan(new) & np.isnan(before))
