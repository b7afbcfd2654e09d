"""Fit of a known camera to frames of another size: square pixels, nothing stretched."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torchweather.camera.frame_sizes import size_change
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments

__all__ = ["CameraFit", "fit_camera", "without_distortion"]


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
    check_arguments("fit_camera(camera: Camera, width: int, height: int)", camera, width, height)
    fitted = camera.fitted_to(width, height)
    return CameraFit(fitted, size_change(camera.width, camera.height, width, height))


def without_distortion(camera: Camera) -> Camera:
    """The same camera with an ideal lens."""
    check_arguments("without_distortion(camera: Camera)", camera)
    return camera.without_distortion()
