"""Camera: geometry, optics and converter of a camera that delivers its raw mosaic.

Frames: the vehicle's x forward, y left, z up; the camera's x right, y down, z along the axis. A pixel's
centre (row i, column j) lies at y = i, x = j.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypedDict, Unpack

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.frame_sizes import size_change
from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.distributions import Distribution
from torchweather.core.errors import (
    InputValueError,
    check_at_least,
    check_between,
    check_one_of,
)
from torchweather.core.fields import above, at_least, between, check_fields
from torchweather.pipeline.sensor import Sensor

__all__ = ["BAYER_PATTERNS", "Camera"]

BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG", "RCCB")

# Iterations of the fixed point that inverts Brown-Conrady; each one gains a factor |distortion| < 0.3.
UNDISTORT_ITERATIONS = 12


_COEFFICIENT = between(-1e3, 1e3)
RANGES = {
    **dict.fromkeys(("width", "height"), at_least(1, 1e5, "px")),
    **dict.fromkeys(("fx", "fy"), above(0.0, 1e7, "px")),
    **dict.fromkeys(("cx", "cy"), between(-1e7, 1e7, "px")),
    **dict.fromkeys(("wavelengths_nm", "clear_wavelength_nm"), between(300.0, 2500.0, "nm")),
    "bit_depth": between(1, 32, "bits"),
    "black_level": at_least(0.0, 2.0**32),
    "white_level": at_least(0.0, 2.0**32),
    "exposure_s": above(0.0, 3600.0, "s"),
    "f_number": above(0.0, 1e3),
    "focal_length_mm": above(0.0, 1e4, "mm"),
    "focus_distance_m": above(0.0, math.inf, "m"),
    "lens_blur_px": at_least(0.0, 1e3, "px"),
    "roll_rad": between(-math.pi, math.pi, "rad"),
    "pitch_rad": between(-math.pi / 2, math.pi / 2, "rad"),
    "height_m": above(0.0, 1e5, "m"),
    **dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), _COEFFICIENT),
}
"""Values that a camera's fields take."""


class CameraFields(TypedDict, total=False):
    """Fields that a preset can be given anew, by name; those of `Camera`."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float | None
    cy: float | None
    bayer_pattern: str
    wavelengths_nm: tuple[float, float, float]
    clear_wavelength_nm: float
    bit_depth: int
    black_level: float
    white_level: float | None
    response_knots: tuple[tuple[float, float], ...] | None
    exposure_s: float | Distribution
    f_number: float | Distribution | None
    focal_length_mm: float | None
    focus_distance_m: float | Distribution | None
    lens_blur_px: float
    roll_rad: float
    pitch_rad: float
    height_m: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


@dataclass(frozen=True)
class Camera(Sensor):
    """A camera that delivers its raw Bayer mosaic.

    Args:
        width, height: pixels; both even.
        fx, fy: focal length in pixels.
        cx, cy: principal point in pixels; the default is the image's centre.
        bayer_pattern: colours of the top-left 2 x 2 cell read in rows; C is a clear (unfiltered) pixel.
        wavelengths_nm: blue, green, red; 460, 530, 600 nm as in D3.4. Clear pixels use ``clear_wavelength_nm``.
        bit_depth: bits of the raw value; sets the default ``white_level``.
        black_level, white_level: raw values of black and of saturation.
        response_knots: companding of the raw value, points (linear, raw), both rising from (0, 0) to (1, 1);
            ``None`` where raw is linear in light.
        exposure_s: exposure time, seconds.
        f_number, focal_length_mm, focus_distance_m: defocus; ``f_number=None`` is a pinhole (no defocus),
            ``focus_distance_m=None`` is focus at infinity.
        lens_blur_px: diameter of the disk that has the variance of the lens's point spread, pixels; it softens the
            marks of particles (the frame has its own already).
        roll_rad, pitch_rad: mounting; pitch positive looks up, roll positive turns the camera clockwise as seen
            from behind it.
        height_m: height of the camera over flat ground.
        k1, k2, p1, p2, k3: Brown-Conrady lens distortion (OpenCV order and sign).

    Example:
        >>> Camera.from_intrinsics(fx=721.5, fy=721.5, cx=609.6, cy=172.9, width=1242, height=374).width
        1242
    """

    kind: ClassVar[str] = "camera"
    data_key: ClassVar[str] = "image"
    drawable: ClassVar[tuple[str, ...]] = ("exposure_s", "f_number", "focus_distance_m")

    width: int
    height: int
    fx: float
    fy: float
    cx: float | None = None
    cy: float | None = None
    bayer_pattern: str = "RGGB"
    wavelengths_nm: tuple[float, float, float] = (460.0, 530.0, 600.0)
    clear_wavelength_nm: float = 550.0
    bit_depth: int = 12
    black_level: float = 0.0
    white_level: float | None = None
    response_knots: tuple[tuple[float, float], ...] | None = None
    exposure_s: float = 0.005
    f_number: float | None = None
    focal_length_mm: float | None = None
    focus_distance_m: float | None = None
    lens_blur_px: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    height_m: float = 1.5
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    if TYPE_CHECKING:

        @classmethod
        def preset(cls, name: str, **overrides: Unpack[CameraFields]) -> Self:  # type: ignore[override]
            """As of every sensor."""
            ...

    def __post_init__(self) -> None:
        if self._ends_are_good():
            return
        check_one_of("bayer_pattern", self.bayer_pattern, BAYER_PATTERNS, owner=self)
        check_fields(self, RANGES)
        object.__setattr__(self, "cx", (self.width - 1) / 2 if self.cx is None else self.cx)
        object.__setattr__(self, "cy", (self.height - 1) / 2 if self.cy is None else self.cy)
        white = float(2**self.bit_depth - 1) if self.white_level is None else self.white_level
        object.__setattr__(self, "white_level", white)
        if white <= self.black_level:
            raise InputValueError(
                f"Camera: white_level must exceed black_level; got {white:g} and {self.black_level:g}."
            )
        if self.f_number is not None and self.focal_length_mm is None:
            RANGES["focal_length_mm"].check("focal_length_mm", None, self)
        if self.response_knots is not None:
            self._check_knots(self.response_knots)

    def _check_knots(self, knots: tuple[tuple[float, float], ...]) -> None:
        try:
            points = tuple((float(linear), float(raw)) for linear, raw in knots)
        except (TypeError, ValueError):
            points = ()
        rising = all(a[0] < b[0] and a[1] < b[1] for a, b in pairwise(points))
        if len(points) < 2 or points[0] != (0.0, 0.0) or points[-1] != (1.0, 1.0) or not rising:
            raise InputValueError(
                "Camera: response_knots must be points (linear, raw) that both rise from (0, 0) to (1, 1); "
                f"got {knots!r}."
            )
        object.__setattr__(self, "response_knots", points)

    @classmethod
    def from_intrinsics(
        cls, fx: float, fy: float, cx: float, cy: float, width: int, height: int, **more: Any
    ) -> Camera:
        """A camera from its calibration matrix, pixels; every other field by keyword."""
        check_arguments(
            "Camera.from_intrinsics(fx: float, fy: float, cx: float, cy: float, width: int, height: int)",
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        )
        return cls.from_dict({"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, **more})

    @classmethod
    def from_field_of_view(
        cls, horizontal_rad: float, vertical_rad: float, width: int, height: int, **more: Any
    ) -> Camera:
        """A distortion-free camera from its full angles of view, radians."""
        check_arguments(
            "Camera.from_field_of_view(horizontal_rad: float, vertical_rad: float, width: int, height: int)",
            horizontal_rad,
            vertical_rad,
            width,
            height,
        )
        check_between("horizontal_rad", horizontal_rad, 1e-3, math.pi - 1e-3, unit="rad", owner=cls)
        check_between("vertical_rad", vertical_rad, 1e-3, math.pi - 1e-3, unit="rad", owner=cls)
        fx = width / 2 / math.tan(horizontal_rad / 2)
        fy = height / 2 / math.tan(vertical_rad / 2)
        return cls.from_dict({"width": width, "height": height, "fx": fx, "fy": fy, **more})

    @property
    def principal_point_px(self) -> tuple[float, float]:
        """cx, cy."""
        assert self.cx is not None  # both set in __post_init__
        assert self.cy is not None
        return self.cx, self.cy

    @property
    def intrinsics(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy in pixels."""
        return (self.fx, self.fy, *self.principal_point_px)

    @property
    def saturation_level(self) -> float:
        """Raw value of saturation."""
        assert self.white_level is not None  # set in __post_init__
        return self.white_level

    @property
    def distorted(self) -> bool:
        """True where the lens distorts."""
        return any((self.k1, self.k2, self.p1, self.p2, self.k3))

    @property
    def aperture_m(self) -> float:
        """Diameter of the entrance pupil, metres; 0 for a pinhole."""
        if self.f_number is None or self.focal_length_mm is None:
            return 0.0
        return self.focal_length_mm * 1e-3 / self.f_number

    @property
    def bands(self) -> dict[str, float]:
        """Colours of the CFA and their wavelengths, nm, in the order of the CFA index (red, green or clear, blue)."""
        blue, green, red = self.wavelengths_nm
        middle = ("clear", self.clear_wavelength_nm) if "C" in self.bayer_pattern else ("green", green)
        return {"red": red, middle[0]: middle[1], "blue": blue}

    def cropped(self, top: int, left: int, height: int, width: int) -> Camera:
        """The camera that sees only a window of the image; even offsets keep the Bayer phase."""
        check_arguments("Camera.cropped(top: int, left: int, height: int, width: int)", top, left, height, width)
        if top % 2 or left % 2:
            raise InputValueError(f"Camera: top and left must be even to keep the Bayer phase; got {top}, {left}.")
        cx, cy = self.principal_point_px
        return replace(self, width=width, height=height, cx=cx - left, cy=cy - top)

    def fitted_to(self, width: int, height: int) -> Camera:
        """The camera for frames of another size: the same horizontal view, square pixels, nothing stretched.

        Rows above and below the principal point are cropped or added; frames of the same aspect ratio (within 1 %)
        are `resized`. `torchweather.sensors.fit_camera` has the details and tells which was done.

        Example:
            >>> Camera.preset("lucid-triton").fitted_to(1242, 375).fy  # fx as well
            729.67...
        """
        check_arguments("Camera.fitted_to(width: int, height: int)", width, height)
        for name, value in (("width", width), ("height", height)):
            check_at_least(name, value, 1, unit="px", owner="fit_camera")
        change = size_change(self.width, self.height, width, height)
        if change == "same":
            return self
        if change == "scaled":
            return self.resized(width, height)
        if change == "turned":
            return self._turned(width, height)
        cx, cy = self.principal_point_px
        across, down = width / self.width, height / self.height
        focal = self.fx * across
        fitted = replace(
            self,
            width=width,
            height=height,
            fx=focal,
            fy=focal,
            cx=(cx + 0.5) * across - 0.5,
            cy=(cy + 0.5) * down - 0.5,
            lens_blur_px=self.lens_blur_px * across,
        )
        # 1 %: a frame of nearly the same corner is inside what the calibration saw.
        inside = fitted._corner() <= 1.01 * self._corner()
        return fitted if inside or not self.distorted else fitted.without_distortion()

    def _turned(self, width: int, height: int) -> Camera:
        """The camera turned by a quarter: nobody knows to which side, so the principal point goes to the centre."""
        focal, long_side = (self.fx, self.width) if self.width > self.height else (self.fy, self.height)
        scale = max(width, height) / long_side
        turned = replace(
            self,
            width=width,
            height=height,
            fx=focal * scale,
            fy=focal * scale,
            cx=None,
            cy=None,
            lens_blur_px=self.lens_blur_px * scale,
        )
        return turned.without_distortion()

    def _corner(self) -> float:
        """Largest distance of a corner of the image from the axis, in normalised coordinates."""
        cx, cy = self.principal_point_px
        return math.hypot(max(cx, self.width - 1 - cx) / self.fx, max(cy, self.height - 1 - cy) / self.fy)

    def without_distortion(self) -> Camera:
        """The same camera with an ideal lens."""
        return replace(self, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0)

    def resized(self, width: int, height: int) -> Camera:
        """The same view on another pixel grid, stretched where the aspect ratio differs (`fitted_to` does not)."""
        check_arguments("Camera.resized(width: int, height: int)", width, height)
        check_between("width", width, 1, 1 << 24, unit="px", owner="Camera.resized")
        check_between("height", height, 1, 1 << 24, unit="px", owner="Camera.resized")
        sx, sy = width / self.width, height / self.height
        cx, cy = self.principal_point_px
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            lens_blur_px=self.lens_blur_px * math.sqrt(sx * sy),
            cx=(cx + 0.5) * sx - 0.5,
            cy=(cy + 0.5) * sy - 0.5,
        )

    def down_direction(self) -> tuple[float, float, float]:
        """Unit vector of gravity in camera coordinates (x right, y down, z along the axis).

        Example:
            >>> Camera.preset("lucid-triton").down_direction()
            (0.0, 1.0, 0.0)
        """
        down, forward = math.cos(self.pitch_rad), -math.sin(self.pitch_rad)
        return (down * math.sin(self.roll_rad), down * math.cos(self.roll_rad), forward + 0.0)

    def camera_from_vehicle(self) -> tuple[tuple[float, float, float], ...]:
        """Rotation ``R`` (rows) with ``v_camera = R v_vehicle``; vehicle x forward, y left, z up."""
        cp, sp = math.cos(self.pitch_rad), math.sin(self.pitch_rad)
        cr, sr = math.cos(self.roll_rad), math.sin(self.roll_rad)
        right, down, forward = (0.0, -1.0, 0.0), (sp, 0.0, -cp), (cp, 0.0, sp)
        rolled_right = tuple(cr * r + sr * d for r, d in zip(right, down, strict=True))
        rolled_down = tuple(-sr * r + cr * d for r, d in zip(right, down, strict=True))
        return (rolled_right, rolled_down, forward)  # type: ignore[return-value]

    def distort(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Brown-Conrady: undistorted normalised coordinates (x/z, y/z) to distorted ones."""
        check_arguments("Camera.distort(x: floating, y: floating)", x, y)
        check_broadcast("Camera.distort", x=x, y=y)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return (
            x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
            y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
        )

    def undistort(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Distorted normalised coordinates to undistorted ones, by fixed point; identity without distortion.

        Coordinates that the lens cannot reach, outside the picture, become those of its outermost ray.
        """
        check_arguments("Camera.undistort(x: Tensor, y: Tensor)", x, y)
        if not self.distorted:
            return x, y
        xu, yu, fold = x, y, self._fold_radius()
        for _ in range(UNDISTORT_ITERATIONS):
            xd, yd = self.distort(xu, yu)
            xu, yu = xu + (x - xd), yu + (y - yd)
            if math.isfinite(fold):
                shrink = (fold / torch.sqrt(xu * xu + yu * yu).clamp_min(1e-12)).clamp_max(1.0)
                xu, yu = xu * shrink, yu * shrink
        return xu, yu

    def _fold_radius(self) -> float:
        """Undistorted radius at which ``r (1 + k1 r^2 + k2 r^4 + k3 r^6)`` stops growing; infinity where it does not.

        No ray of the lens lies outside of it: there the polynomial is beyond what it was fitted to.
        """
        roots = np.roots([7.0 * self.k3, 5.0 * self.k2, 3.0 * self.k1, 1.0])
        real = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and root.real > 0]
        return math.sqrt(min(real)) if real else math.inf

    def distortion_jacobian(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Derivatives of the distorted by the undistorted coordinates: dx'/dx, dx'/dy, dy'/dx, dy'/dy."""
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2 * (self.k1 + r2 * (2 * self.k2 + 3 * self.k3 * r2))  # d radial / d r2, times 2
        xx = radial + x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x
        xy = x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y
        yy = radial + y * y * slope + 6 * self.p1 * y + 2 * self.p2 * x
        return xx, xy, xy, yy

    def magnification(self, x: Tensor, y: Tensor) -> Tensor:
        """Areal magnification of the lens distortion at undistorted coordinates; 1 without distortion."""
        check_arguments("Camera.magnification(x: Tensor, y: Tensor)", x, y)
        if not self.distorted:
            return torch.ones_like(x)
        xx, xy, yx, yy = self.distortion_jacobian(x, y)
        return (xx * yy - xy * yx).clamp_min(1e-3)

    def ray_directions(
        self,
        height: int | None = None,
        width: int | None = None,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> Tensor:
        """Direction of every pixel's ray in camera coordinates, scaled to z = 1 (lens distortion removed).

        Returns:
            ``(3, H, W)``: x/z, y/z, 1. A pixel of depth Z metres lies at ``Z * direction``.

        Example:
            >>> Camera.preset("lucid-triton").ray_directions().shape
            torch.Size([3, 1464, 1936])
        """
        check_arguments(
            "Camera.ray_directions(height: int | None, width: int | None, dtype: dtype)",
            height,
            width,
            dtype,
        )
        h, w = height or self.height, width or self.width
        for name, size in (("height", h), ("width", w)):
            if isinstance(size, int):  # a traced graph's is no number yet
                check_between(name, size, 1, 1 << 20, unit="px", owner="Camera.ray_directions")
        cx, cy = self.principal_point_px
        x = (torch.arange(w, device=device, dtype=dtype) - cx) / self.fx
        y = (torch.arange(h, device=device, dtype=dtype) - cy) / self.fy
        xu, yu = self.undistort(x.expand(h, w), y[:, None].expand(h, w))
        return torch.stack([xu, yu, torch.ones_like(xu)])
