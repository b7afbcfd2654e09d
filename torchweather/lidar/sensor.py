"""Lidar: beam, link budget, near-range response, return mode and intensity unit of a scanning LiDAR.

Frame: x forward, y left, z up; azimuth from x to y, elevation up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypedDict, Unpack

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution
from torchweather.core.errors import (
    InputTypeError,
    InputValueError,
    check_between,
    check_one_of,
)
from torchweather.core.fields import above, at_least, between, check_fields
from torchweather.lidar.pose import checked_origin, checked_rotation, split_pose
from torchweather.pipeline.sensor import Sensor

__all__ = ["INTENSITY_UNITS", "RETURN_MODES", "Lidar"]

RETURN_MODES = ("strongest", "last", "first", "dual")
INTENSITY_UNITS = ("reflectivity", "reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons", "none")
SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
# Reflectivity of the target to which `range_at_10_percent_m` refers.
CALIBRATION_REFLECTIVITY = 0.1
# Near-range response of Hahner 2022: full overlap at 1 m. No recording shows the fog returns that follow from it
# (PHYSICS.md 5.3).
HAHNER_OVERLAP_M = (0.9, 1.0)


RANGES = {
    "wavelength_nm": between(300.0, 2500.0, "nm"),
    "exit_diameter_mm": above(0.0, 1e4, "mm"),
    "divergence_mrad": above(0.0, 1e3, "mrad"),
    "pulse_width_ns": above(0.0, 1e4, "ns"),
    "range_at_10_percent_m": above(0.0, 1e5, "m"),
    "near_power": above(0.0, 100.0),
    "near_full_m": above(0.0, 1e5, "m"),
    "max_range_m": above(0.0, 1e5, "m"),
    "photons_at_threshold": above(0.0, 1e12),
    "margin_db": above(0.0, 100.0, "dB"),
    "assumed_reflectivity": above(0.0, 1e3),
    **dict.fromkeys(("near_start_m", "min_range_m"), at_least(0.0, 1e5, "m")),
    **dict.fromkeys(("range_resolution_m", "range_noise_m", "echo_separation_m"), at_least(0.0, 1e4, "m")),
    "zero_intensity": at_least(0.0, 1e12),
    "elevations_deg": between(-90.0, 90.0, "degrees"),
    "azimuth_offsets_deg": between(-360.0, 360.0, "degrees"),
    "origin_heights_m": between(-10.0, 10.0, "m"),
    "azimuths_deg": between(-180.0, 180.0, "degrees"),
    "columns": at_least(1, 1e6),
    "ring_column": at_least(4, 1e4),
    "speed_column": at_least(4, 1e4),
    "speed_noise_m_per_s": at_least(0.0, 100.0, "m/s"),
}
"""Values that a LiDAR's fields take."""


class LidarFields(TypedDict, total=False):
    """Fields that a preset can be given anew, by name; those of `Lidar`."""

    wavelength_nm: float
    exit_diameter_mm: float | Distribution
    divergence_mrad: float | Distribution
    pulse_width_ns: float | Distribution
    range_at_10_percent_m: float | Distribution
    near_start_m: float | Distribution
    near_full_m: float | Distribution
    near_power: float | Distribution
    min_range_m: float
    max_range_m: float
    photons_at_threshold: float | Distribution
    range_resolution_m: float
    range_noise_m: float | Distribution
    return_mode: str
    margin_db: float | Distribution
    echo_separation_m: float | None
    intensity_unit: str
    assumed_reflectivity: float | Distribution
    zero_intensity: float | None
    elevations_deg: tuple[float, ...] | None
    columns: int | None
    azimuths_deg: tuple[float, ...] | None
    azimuth_offsets_deg: tuple[float, ...] | None
    origin_heights_m: tuple[float, ...] | None
    ring_column: int | None
    speed_column: int | None
    speed_noise_m_per_s: float
    origin_m: tuple[float, float, float]
    rotation: tuple[tuple[float, float, float], ...] | None
    directions: Tensor | None


@dataclass(frozen=True)
class Lidar(Sensor):
    """A scanning LiDAR.

    Args:
        wavelength_nm: laser wavelength.
        exit_diameter_mm: beam diameter at the exit window.
        divergence_mrad: full angle of the beam (FWHM); the beam is a cone of diameter d0 + theta R.
        pulse_width_ns: pulse width (FWHM).
        range_at_10_percent_m: range at which a 10 % Lambertian target is just detected; it calibrates the link.
        near_start_m, near_full_m, near_power: near-range response of the receiver (overlap, defocus, gain),
            ``xi(R) = clip((R - near_start) / (near_full - near_start), 0, 1) ** near_power``. It decides most of what
            fog and snow look like.
        min_range_m, max_range_m: nothing nearer is a return (rows of a cloud that lie there hold none), no particle
            farther is reported; a beam without return is simulated to ``max_range_m``.
        photons_at_threshold: photons of a signal at the detection threshold, for photon noise and the unit ``photons``.
        range_resolution_m, range_noise_m: rounding and standard deviation of the range of a particle's return (the
            input's own returns have theirs already).
        return_mode: ``strongest``, ``last``, ``first``, or ``dual`` (strongest and last).
        margin_db: a return in the input was detected: its signal is at least the threshold times an exponentially
            distributed margin of this mean, dB.
        echo_separation_m: echoes closer than this merge; ``None`` is half the pulse length, c tau / 2.
        intensity_unit: of the fourth column: ``reflectivity`` (1 = Lambertian white), ``reflectivity_percent``,
            ``uint8_linear`` (255 = 1), ``uint8_calibrated`` (0-100 percent, above retroreflective), ``photons``, or
            ``none`` (a column without meaning; every return counts as ``assumed_reflectivity``).
        assumed_reflectivity: reflectivity of every target where the unit is ``none``.
        zero_intensity: intensity that a value of 0 stands for, in the unit: a sensor that counts in steps rounds
            ``[0, step)`` down to it. ``None`` is half a step where the data have one (integers of 8 bits, multiples of
            0.01), else 0.
        elevations_deg: elevation of each ring, in the order of the sensor's ring numbers; ``None`` is unknown.
        columns: firings of each ring per turn; of a flash its columns of pixels.
        azimuths_deg: azimuth of each column of a flash (solid-state) sensor, which does not turn and sees all pixels of
            ``elevations_deg`` x ``azimuths_deg`` at once; ``Lidar.flash`` makes them. ``None``: a sensor that turns.
        azimuth_offsets_deg: azimuth of each ring relative to its column; ``None`` is 0.
        origin_heights_m: height of each ring's laser over the cloud's origin; ``None`` is 0.
        ring_column: column of the cloud that holds the ring, 4 or more; ``None`` recovers it from the elevation where
            it is needed.
        speed_column: column of the cloud that holds the radial speed of each point, m/s, positive away from the sensor,
            4 or more: a Doppler (FMCW) LiDAR. Objects keep theirs, particles get their own. ``None``: no such column.
        speed_noise_m_per_s: standard deviation of the speed of a particle's return.
        origin_m: x, y, z of the sensor in the cloud's frame; (0, 0, 0) where the cloud is in the sensor's own. Weather
            is computed in the sensor's frame and written back in the cloud's (``lidar/cloud_frame.py``).
        rotation: ``(3, 3)`` whose columns are the sensor's x, y and z in the cloud's frame; ``None`` is the identity.
            ``with_pose`` takes both from a matrix.
        directions: ``(N, 3)`` direction of every row of an organised cloud in the cloud's frame, so that beams without
            return can be simulated too; not compared by ``==``.

    Example:
        >>> lidar = Lidar.preset("ouster-os1-128", return_mode="dual")
        >>> round(lidar.echo_separation, 2), f"{lidar.threshold_per_m2_sr:.2e}"
        (1.5, '1.99e-05')
    """

    kind: ClassVar[str] = "lidar"
    drawable: ClassVar[tuple[str, ...]] = (
        *("divergence_mrad", "exit_diameter_mm", "pulse_width_ns", "range_at_10_percent_m"),
        *("near_start_m", "near_full_m", "near_power"),
        *("photons_at_threshold", "range_noise_m", "margin_db", "assumed_reflectivity"),
    )
    data_fields: ClassVar[tuple[str, ...]] = ("directions",)

    wavelength_nm: float
    exit_diameter_mm: float = 10.0
    divergence_mrad: float = 2.0
    pulse_width_ns: float = 10.0
    range_at_10_percent_m: float = 50.0
    near_start_m: float = 2.0
    near_full_m: float = 10.0
    near_power: float = 1.0
    min_range_m: float = 0.0
    max_range_m: float = 120.0
    photons_at_threshold: float = 10.0
    range_resolution_m: float = 0.0
    range_noise_m: float = 0.0
    return_mode: str = "strongest"
    margin_db: float = 1.0
    echo_separation_m: float | None = None
    intensity_unit: str = "reflectivity"
    assumed_reflectivity: float = 0.1
    zero_intensity: float | None = None
    elevations_deg: tuple[float, ...] | None = None
    columns: int | None = None
    azimuths_deg: tuple[float, ...] | None = None
    azimuth_offsets_deg: tuple[float, ...] | None = None
    origin_heights_m: tuple[float, ...] | None = None
    ring_column: int | None = None
    speed_column: int | None = None
    speed_noise_m_per_s: float = 0.0
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[tuple[float, float, float], ...] | None = None
    directions: Tensor | None = field(default=None, compare=False, repr=False)

    if TYPE_CHECKING:

        @classmethod
        def preset(cls, name: str, **overrides: Unpack[LidarFields]) -> Self:  # type: ignore[override]
            """As of every sensor."""
            ...

    def __post_init__(self) -> None:
        if self._ends_are_good():
            return
        object.__setattr__(self, "origin_m", checked_origin(self.origin_m))
        check_fields(self, RANGES)
        check_one_of("return_mode", self.return_mode, RETURN_MODES, owner=self)
        check_one_of("intensity_unit", self.intensity_unit, INTENSITY_UNITS, owner=self)
        if self.speed_column is not None and self.speed_column == self.ring_column:
            raise InputValueError(
                f"Lidar: speed_column and ring_column must be different columns; got {self.speed_column} for both."
            )
        self._check_ranges()
        self._check_pattern()
        object.__setattr__(self, "rotation", checked_rotation(self.rotation))
        if self.directions is not None:
            object.__setattr__(self, "directions", unit_directions(self.directions, owner=self))

    def _check_ranges(self) -> None:
        if not self.near_start_m < self.near_full_m:
            raise InputValueError(
                "Lidar: near_full_m must exceed near_start_m (the receiver's response rises between them); got "
                f"{self.near_full_m:g} and {self.near_start_m:g} m."
            )
        if not max(self.min_range_m, self.near_start_m) < self.max_range_m:
            raise InputValueError(
                "Lidar: max_range_m must exceed min_range_m and near_start_m; got "
                f"{self.max_range_m:g}, {self.min_range_m:g} and {self.near_start_m:g} m."
            )

    def _check_pattern(self) -> None:
        if self.azimuths_deg is not None:
            if self.elevations_deg is None or self.columns not in (None, len(self.azimuths_deg)):
                raise InputValueError(
                    "Lidar: azimuths_deg are the columns of a flash: they need elevations_deg, and columns of their "
                    f"number, {len(self.azimuths_deg)}, or None; got {self.columns} columns."
                )
            if self.azimuth_offsets_deg is not None:
                raise InputValueError(
                    "Lidar: azimuth_offsets_deg are of rings that turn; a flash has azimuths_deg alone."
                )
            object.__setattr__(self, "columns", len(self.azimuths_deg))
        for name in ("elevations_deg", "azimuth_offsets_deg", "origin_heights_m"):
            values = getattr(self, name)
            if values is not None and len(values) != len(self.elevations_deg or ()):
                raise InputValueError(
                    f"Lidar: {name} must have one value for each of the {len(self.elevations_deg or ())} "
                    f"elevations_deg; got {len(values)}."
                )

    @classmethod
    def flash(
        cls,
        wavelength_nm: float,
        *,
        view_deg: tuple[float, float],
        columns: int,
        rows: int,
        **fields: Any,
    ) -> Self:
        """A flash (solid-state) LiDAR: a grid of pixels that all see one shot.

        Each pixel sees the cone whose solid angle is that of the pixel, ``theta = sqrt(4 / pi a b)`` with its width a
        and height b; it takes the place of the beam's divergence.

        Args:
            wavelength_nm: laser wavelength.
            view_deg: azimuth and elevation that the pixels cover, full angles, about the x axis.
            columns, rows: of pixels.
            fields: further fields of the sensor; a ``divergence_mrad`` stands for the pixel's cone.

        Example:
            >>> lidar = Lidar.flash(1064.0, view_deg=(120.0, 30.0), columns=128, rows=32)
            >>> lidar.azimuths_deg[0], lidar.elevations_deg[0], round(lidar.divergence_mrad, 2)
            (59.53125, 14.53125, 18.46)
        """
        check_arguments(
            "Lidar.flash(wavelength_nm: float, view_deg: Sequence[float], columns: int, rows: int)",
            wavelength_nm,
            view_deg,
            columns,
            rows,
        )
        if len(view_deg) != 2:
            raise InputValueError(f"Lidar.flash: view_deg must be (azimuth, elevation) in degrees; got {view_deg!r}.")
        check_between("view_deg[0]", view_deg[0], 1e-3, 359.0, unit="degrees", owner="Lidar.flash")
        check_between("view_deg[1]", view_deg[1], 1e-3, 179.0, unit="degrees", owner="Lidar.flash")
        for name, count in (("columns", columns), ("rows", rows)):
            check_between(name, count, 1, 100_000, owner="Lidar.flash")
        steps = [float(view) / int(count) for view, count in zip(view_deg, (columns, rows), strict=True)]
        azimuths, elevations = (
            tuple(step * (0.5 * (int(count) - 1) - place) for place in range(int(count)))
            for step, count in zip(steps, (columns, rows), strict=True)
        )
        cone_mrad = 1e3 * math.sqrt(4.0 / math.pi * math.radians(steps[0]) * math.radians(steps[1]))
        pattern = {"azimuths_deg": azimuths, "elevations_deg": elevations}
        return cls(wavelength_nm, **{"divergence_mrad": cone_mrad, **fields, **pattern})

    @property
    def bands(self) -> dict[str, float]:
        """The laser line: its name and wavelength, nm."""
        return {"laser": self.wavelength_nm}

    @property
    def column_step_deg(self) -> float | None:
        """Azimuth from one column to the next, degrees; ``None`` where the columns are not known."""
        if self.azimuths_deg is not None and len(self.azimuths_deg) > 1:
            return (max(self.azimuths_deg) - min(self.azimuths_deg)) / (len(self.azimuths_deg) - 1)
        return None if self.columns is None else 360.0 / self.columns

    @property
    def pulse_length_m(self) -> float:
        """Half the length of the pulse in space, c tau / 2: the range that one pulse width covers, metres."""
        return 0.5 * SPEED_OF_LIGHT_M_PER_S * self.pulse_width_ns * 1e-9

    @property
    def echo_separation(self) -> float:
        """Distance below which two echoes merge, metres."""
        return self.pulse_length_m if self.echo_separation_m is None else self.echo_separation_m

    @property
    def threshold_per_m2_sr(self) -> float:
        """Detection threshold over the system constant, ``X_thr = (0.1 / pi) / R10^2``, 1/(m^2 sr) (PHYSICS.md 5.3)."""
        return CALIBRATION_REFLECTIVITY / math.pi / self.range_at_10_percent_m**2

    def with_hahner_overlap(self) -> Lidar:
        """The same sensor with the near-range response of Hahner 2022: none below 0.9 m, full from 1 m on."""
        start, full = HAHNER_OVERLAP_M
        return replace(self, near_start_m=start, near_full_m=full, near_power=1.0)

    def with_pose(self, pose: Tensor | Sequence[Sequence[float]]) -> Lidar:
        """The same sensor at a pose in the cloud's frame.

        Args:
            pose: ``T_cloud_from_sensor`` ``(4, 4)``, or its first three rows; metres.

        Example:
            >>> Lidar(905.0).with_pose([[1, 0, 0, 1.43], [0, 1, 0, 0], [0, 0, 1, 2.18], [0, 0, 0, 1]]).origin_m
            (1.43, 0.0, 2.18)
        """
        check_arguments("Lidar.with_pose(pose: Nested)", pose)
        origin_m, rotation = split_pose(pose)
        return replace(self, origin_m=origin_m, rotation=rotation)

    def near_response(self, range_m: Tensor) -> Tensor:
        """Near-range response xi, 0 to 1, of the shape of ``range_m`` (metres)."""
        check_arguments("Lidar.near_response(range_m: real)", range_m)
        ramp = (range_m - self.near_start_m) / (self.near_full_m - self.near_start_m)
        response: Tensor = ramp.clamp(0.0, 1.0) ** self.near_power
        return response


def unit_directions(directions: Tensor, owner: object) -> Tensor:
    """Directions ``(..., N, 3)``, checked and scaled to unit length."""
    if not isinstance(directions, Tensor):
        try:
            directions = torch.as_tensor(directions, dtype=torch.float32)
        except (TypeError, ValueError, RuntimeError):
            raise InputTypeError(
                f"{type(owner).__name__}: directions must be a tensor (..., N, 3); got {directions!r}."
            ) from None
    if directions.ndim < 2 or directions.shape[-1] != 3 or not directions.is_floating_point():
        raise InputValueError(
            f"{type(owner).__name__}: directions must be floating point of shape (..., N, 3), x forward, y left, z up; "
            f"got {directions.dtype}, {tuple(directions.shape)}."
        )
    length: Tensor = directions.norm(dim=-1, keepdim=True)
    if not torch.compiler.is_compiling() and not bool((torch.isfinite(length) & (length > 0)).all()):
        raise InputValueError(f"{type(owner).__name__}: directions must be finite and none of them zero.")
    return directions / length
