"""CompletedDepthMap: a depth map with unknown pixels, completed; and other encodings of depth."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.depth.completion_scene import CompletedSource, SeenPoints, Sky, at_upper_edge
from torchweather.camera.depth.hidden_points import unseen_points
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_between, check_positive

__all__ = ["CompletedDepthMap", "along_ray_to_axis", "depth_from_disparity"]

# Of a map with more known pixels than this, each measures its own: nothing is projected from another place, so nothing
# is hidden. A LiDAR of 64 beams fills 4 to 6 % of a picture.
_DENSE_SHARE = 0.25
# Known pixels of a dense map this near to unknown ones are enough to complete these.
_RIM_PX = 3


@dataclasses.dataclass(frozen=True, eq=False)
class CompletedDepthMap(CompletedSource):
    """A depth map with unknown pixels, completed as `CompletedDepth` completes a cloud.

    Pixels with a value keep it, except those that the camera cannot see: a projected LiDAR sees past the edges of near
    things, and through the panes of cars.

    Args:
        depth_m: ``(H, W)`` or ``(..., 1, H, W)``, metres along the optical axis. NaN, 0 (as KITTI writes it), negative
            values and ``-inf`` are unknown; ``inf`` is sky.
        sky: as of `CompletedDepth`.
        upper_edge_rad: as of `CompletedDepth`.

    Example:
        >>> depth_m = torch.zeros(4, 6)
        >>> depth_m[1:, ::2] = 10.0
        >>> camera = Camera.from_intrinsics(fx=4, fy=4, cx=2.5, cy=0, width=6, height=4)
        >>> CompletedDepthMap(depth_m)(camera, 4, 6).unique()
        tensor([10.])
    """

    depth_m: Tensor
    sky: Sky = None
    upper_edge_rad: float = 0.03

    def __post_init__(self) -> None:
        check_arguments(
            "CompletedDepthMap(depth_m: real | array, upper_edge_rad: float)",
            self.depth_m,
            self.upper_edge_rad,
        )
        depth_m = torch.as_tensor(self.depth_m).detach().cpu()
        if depth_m.ndim == 2:
            depth_m = depth_m[None]
        if depth_m.ndim < 3 or depth_m.shape[-3] != 1:
            raise InputValueError(
                f"CompletedDepthMap: depth_m must have shape (H, W) or (..., 1, H, W), metres; got "
                f"{tuple(depth_m.shape)}."
            )
        depth_m = depth_m.to(torch.float64)
        depth_m = torch.where(depth_m > 0, depth_m, torch.nan)
        unknown = ~torch.isfinite(depth_m).flatten(-3).any(-1)
        if bool(unknown.any()):
            raise InputValueError(
                "CompletedDepthMap: depth_m must have a finite depth above 0 m in at least one pixel; the whole map is "
                "unknown or sky. Check the encoding (KITTI: uint16 / 256), or use a source without measurements."
            )
        check_at_least("upper_edge_rad", self.upper_edge_rad, 0.0, unit="rad", owner=self)
        object.__setattr__(self, "depth_m", depth_m)

    def seen_points(self, camera: Camera, height: int, width: int) -> tuple[tuple[int, ...], list[SeenPoints]]:
        """Leading dimensions of the maps, and the points of each."""
        if tuple(self.depth_m.shape[-2:]) != (height, width):
            raise InputValueError(
                f"CompletedDepthMap: depth_m must have the image's size, {height} x {width}; got "
                f"{self.depth_m.shape[-2]} x {self.depth_m.shape[-1]}."
            )
        leading = tuple(self.depth_m.shape[:-3])
        ray = camera.ray_directions(height, width, dtype=torch.float64)
        maps = self.depth_m.reshape(-1, height, width)
        return leading, [self._points_of(depth_m.numpy(), camera, ray.numpy()) for depth_m in maps]

    def _points_of(self, depth_m: np.ndarray, camera: Camera, ray: np.ndarray) -> SeenPoints:
        from scipy.ndimage import binary_dilation

        height, width = depth_m.shape
        known = np.isfinite(depth_m)
        dense = known.mean() > _DENSE_SHARE
        if dense and not known.all():
            wanted = known & binary_dilation(np.isnan(depth_m), np.ones((3, 3), bool), iterations=_RIM_PX)
            known = wanted if wanted.any() else known
        row, column = np.nonzero(known)
        value = depth_m[row, column]
        place = column.astype(np.float64), row.astype(np.float64)
        keep = np.ones(len(row), bool)
        if not dense:
            keep = ~unseen_points(*place, value, height, width, camera.fx, camera.fy, camera.height_m)
        measured_m = depth_m.copy()
        measured_m[row[~keep], column[~keep]] = np.nan
        points_xyz = (ray[:, row, column] * value).T
        range_m = np.linalg.norm(points_xyz, axis=-1)
        elevation_rad = -np.arcsin(points_xyz @ np.asarray(camera.down_direction()) / range_m)
        edge = at_upper_edge(elevation_rad, range_m, self.upper_edge_rad)
        # On whole numbers a triangulation is ambiguous, and slow to search: move the points by 1/1000 of a pixel.
        jitter = 1e-3 * (np.random.default_rng(0).random((len(row), 2)) - 0.5)
        pixel_xy = np.stack(place, -1) + jitter
        return SeenPoints(pixel_xy[keep], points_xyz[keep], edge[keep], measured_m, int((~keep).sum()))


def along_ray_to_axis(depth_m: Tensor, camera: Camera) -> Tensor:
    """Depth along the optical axis from distances along each pixel's ray.

    ``z = r / |u|`` with ``u`` the pixel's ray scaled to ``u_z = 1``.

    Args:
        depth_m: ``(..., H, W)`` distances from the lens, metres; NaN and ``inf`` stay.
        camera: intrinsics and lens distortion, of the map's size.

    Returns:
        ``(..., H, W)`` metres, in the dtype of ``depth_m``.

    Example:
        >>> camera = Camera.from_intrinsics(fx=3, fy=3, cx=0, cy=0, width=5, height=1)
        >>> along_ray_to_axis(torch.tensor([[3.0, 3.0, 3.0, 3.0, 5.0]]), camera)[0, [0, 4]]
        tensor([3., 3.])
    """
    check_arguments("along_ray_to_axis(depth_m: Tensor(..., H, W), camera: Camera)", depth_m, camera)
    if not depth_m.is_floating_point():
        raise InputTypeError(f"along_ray_to_axis: depth_m must be floating point, metres; got {depth_m.dtype}.")
    height, width = depth_m.shape[-2:]
    if not depth_m.numel():
        return depth_m
    ray = camera.ray_directions(height, width, device=depth_m.device, dtype=torch.float64)
    along_axis: Tensor = depth_m / torch.linalg.vector_norm(ray, dim=0)
    return along_axis.to(depth_m.dtype)


def depth_from_disparity(disparity_px: Tensor, fx_px: float, baseline_m: float) -> Tensor:
    """Depth from a stereo pair's disparity: ``z = fx B / d``.

    Args:
        disparity_px: any shape, pixels; 0, negative and NaN are unknown.
        fx_px: focal length of the rectified pair, pixels.
        baseline_m: distance between the two lenses, metres.

    Returns:
        Metres along the axis, NaN where unknown.

    Example:
        >>> depth_from_disparity(torch.tensor([40.0, 0.0, -1.0]), fx_px=720.0, baseline_m=0.5)
        tensor([9., nan, nan])
    """
    check_arguments(
        "depth_from_disparity(disparity_px: real, fx_px: float, baseline_m: float)",
        disparity_px,
        fx_px,
        baseline_m,
    )
    check_positive("fx_px", fx_px, unit="px", owner="depth_from_disparity")
    check_positive("baseline_m", baseline_m, unit="m", owner="depth_from_disparity")
    check_between("fx_px", fx_px, 0.0, 1e9, unit="px", owner="depth_from_disparity")
    check_between("baseline_m", baseline_m, 0.0, 1e6, unit="m", owner="depth_from_disparity")
    disparity_px = disparity_px if disparity_px.is_floating_point() else disparity_px.to(torch.float32)
    known = disparity_px > 0
    return torch.where(known, float(fx_px) * float(baseline_m) / torch.where(known, disparity_px, 1.0), torch.nan)
