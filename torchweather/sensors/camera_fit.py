"""Fit of a known camera to frames of another size: square pixels, nothing stretched."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from torchweather.errors import check_at_least

if TYPE_CHECKING:
    from torchweather.sensors.camera import Camera

__all__ = ["CameraFit", "fit_camera", "same_aspect", "without_distortion"]

# Two sizes whose aspect ratios differ by less are one picture in two sizes: rounding to whole pixels leaves up to
# 0.8 % on the smallest frames in use here (32 x 24 of 1936 x 1464 px); 16:10 against 16:9 is 11 %.
SAME_ASPECT = 0.01


@dataclass(frozen=True)
class CameraFit:
    """A camera for frames of another size, and how it was made.

    Args:
        camera: the fitted camera.
        how: ``same`` (nothing changed), ``scaled`` (same aspect ratio), ``cropped`` or ``extended`` (same horizontal
            view, less or more of the vertical one), ``turned`` (a portrait frame of a landscape camera, or the other
            way round: the view along the longer side is kept).
    """

    camera: Camera
    how: str

    @property
    def horizontal_view_deg(self) -> float:
        """Full horizontal angle of view without lens distortion, degrees."""
        camera = self.camera
        left = camera.principal_point_px[0] + 0.5
        return math.degrees(math.atan(left / camera.fx) + math.atan((camera.width - left) / camera.fx))


def same_aspect(width: float, height: float, other_width: float, other_height: float) -> bool:
    """True where two sizes have one aspect ratio within 1 %.

    Example:
        >>> same_aspect(1936, 1464, 242, 184), same_aspect(1936, 1464, 1242, 375)
        (True, False)
    """
    return abs(width * other_height / (height * other_width) - 1) <= SAME_ASPECT


def fit_camera(camera: Camera, width: int, height: int) -> CameraFit:
    """The camera for frames of this size, with square pixels where the aspect ratio differs.

    Frames of the same aspect ratio (within 1 %) are the camera's own, rescaled. Others keep its horizontal view:
    ``f = fx width / camera.width`` in both directions. The principal point keeps its relative place, so rows are
    cropped from, or added to, both sides of it in proportion. A frame that is upright where the camera's lies (or
    the other way round) keeps the view along the longer side, with its principal point in the centre.

    Lens distortion is kept where the frame shows no more than the camera saw, and dropped where it shows more (the
    polynomial is not calibrated there) or is turned.

    Args:
        camera: the known camera.
        width, height: size of the frames, pixels.

    Example:
        >>> from torchweather.sensors import Camera
        >>> fit = fit_camera(Camera.preset("lucid-triton"), 1242, 375)
        >>> fit.how, round(fit.camera.fx, 1), round(fit.camera.fy, 1), round(fit.horizontal_view_deg, 1)
        ('cropped', 729.7, 729.7, 80.8)
    """
    for name, value in (("width", width), ("height", height)):
        check_at_least(name, value, 1, unit="px", owner="fit_camera")
    if (width, height) == (camera.width, camera.height):
        return CameraFit(camera, "same")
    if same_aspect(width, height, camera.width, camera.height):
        return CameraFit(camera.resized(width, height), "scaled")
    if (width - height) * (camera.width - camera.height) < 0:
        return CameraFit(_turned(camera, width, height), "turned")
    cx, cy = camera.principal_point_px
    across, down = width / camera.width, height / camera.height
    focal = camera.fx * across
    fitted = replace(
        camera,
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=(cx + 0.5) * across - 0.5,
        cy=(cy + 0.5) * down - 0.5,
        lens_blur_px=camera.lens_blur_px * across,
    )
    # 1 %: a frame of nearly the same corner is inside what the calibration saw.
    if camera.distorted and _corner(fitted) > 1.01 * _corner(camera):
        fitted = without_distortion(fitted)
    return CameraFit(fitted, "cropped" if width * camera.height > camera.width * height else "extended")


def _turned(camera: Camera, width: int, height: int) -> Camera:
    """The camera turned by a quarter: nobody knows to which side, so the principal point goes to the centre."""
    focal, long_side = (camera.fx, camera.width) if camera.width > camera.height else (camera.fy, camera.height)
    scale = max(width, height) / long_side
    turned = replace(
        camera,
        width=width,
        height=height,
        fx=focal * scale,
        fy=focal * scale,
        cx=None,
        cy=None,
        lens_blur_px=camera.lens_blur_px * scale,
    )
    return without_distortion(turned)


def _corner(camera: Camera) -> float:
    """Largest distance of a corner of the image from the axis, in normalised coordinates."""
    cx, cy = camera.principal_point_px
    x = max(cx, camera.width - 1 - cx) / camera.fx
    y = max(cy, camera.height - 1 - cy) / camera.fy
    return math.hypot(x, y)


def without_distortion(camera: Camera) -> Camera:
    """The same camera with an ideal lens."""
    return replace(camera, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0)
