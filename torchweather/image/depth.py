"""Depth of every pixel of an image: constant, from a map, flat ground, a LiDAR cloud, or a depth network.

Depth is metres along the optical axis (not along the ray); ``inf`` is sky.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from torchweather.errors import check_at_least, check_one_of, check_positive
from torchweather.image.depth_fill import fill_linear, fill_nearest, paint_sky
from torchweather.sensors import Camera

__all__ = [
    "ConstantDepth",
    "DepthFromCallable",
    "DepthFromPoints",
    "DepthMap",
    "DepthSource",
    "FlatGround",
    "as_depth_source",
    "check_depth",
    "project_points",
]

# Points nearer than this to the camera's plane belong to the sensor's own mounting, and their projection explodes.
_NEAREST_POINT_M = 0.1


class DepthSource(ABC):
    """Anything that knows the depth of a camera's image.

    Called as ``source(camera, height, width, device=..., dtype=..., image=...)``, it gives ``(..., 1, H, W)``, metres
    along the optical axis, ``inf`` for sky. ``image`` is needed by `DepthFromCallable` only.
    """

    @abstractmethod
    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """Depth ``(..., 1, H, W)`` in metres along the optical axis; ``inf`` is sky."""


@dataclasses.dataclass(frozen=True)
class ConstantDepth(DepthSource):
    """The same depth everywhere: a wall across the optical axis.

    Args:
        depth_m: metres along the optical axis, 0 or more; ``inf`` is sky.

    Example:
        >>> ConstantDepth(30.0)(Camera.preset("lucid-triton"), 2, 2)
        tensor([[[30., 30.],
                 [30., 30.]]])
    """

    depth_m: float

    def __post_init__(self) -> None:
        check_at_least("depth_m", self.depth_m, 0.0, unit="m", owner=self)

    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """Depth ``(1, H, W)``, metres."""
        return torch.full((1, height, width), float(self.depth_m), device=device, dtype=dtype)


@dataclasses.dataclass(frozen=True, eq=False)
class DepthMap(DepthSource):
    """Depth that is known already: a stereo result, a renderer's buffer.

    Args:
        depth_m: ``(H, W)`` or ``(..., 1, H, W)``, metres along the optical axis, 0 or more; ``inf`` is sky.

    Example:
        >>> DepthMap(torch.full((2, 2), 5.0))(Camera.preset("lucid-triton"), 2, 2).shape
        torch.Size([1, 2, 2])
    """

    depth_m: Tensor

    def __post_init__(self) -> None:
        depth = torch.as_tensor(self.depth_m)
        depth = depth if depth.is_floating_point() else depth.to(torch.float32)
        object.__setattr__(self, "depth_m", depth[None] if depth.ndim == 2 else depth)
        check_depth(self.depth_m, owner=self)

    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """The map; a shape other than the image's is refused."""
        if tuple(self.depth_m.shape[-2:]) != (height, width):
            raise ValueError(
                f"DepthMap: depth must have the image's size, {height} x {width}; got "
                f"{self.depth_m.shape[-2]} x {self.depth_m.shape[-1]}. Resize it by nearest neighbour: an average "
                "across an edge is a depth where nothing is."
            )
        return self.depth_m.to(device=device, dtype=dtype)


@dataclasses.dataclass(frozen=True)
class FlatGround(DepthSource):
    """Depth of an endless flat road below the camera, with sky above the horizon.

    ``Z = h / (u . g)`` with ``u`` the pixel's ray scaled to ``u_z = 1`` (lens distortion removed), ``g`` the unit
    vector of gravity in the camera's frame and ``h`` the height; ``inf`` where the ray does not fall.

    Args:
        camera_height_m: height of the camera above the road. Default: the camera's ``height_m``.
        pitch_rad: mounting, positive looks up. Default: the camera's ``pitch_rad``. Roll is always the camera's.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=0, cy=0, width=2, height=52)
        >>> depth = FlatGround(camera_height_m=1.5)(camera, 52, 2)
        >>> depth[0, [0, 10, 50], 0]          # horizon; 1.5 m below the axis at 100/10 and 100/50 times that
        tensor([inf, 15.,  3.])
    """

    camera_height_m: float | None = None
    pitch_rad: float | None = None

    def __post_init__(self) -> None:
        if self.camera_height_m is not None:
            check_positive("camera_height_m", self.camera_height_m, unit="m", owner=self)

    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """Depth ``(1, H, W)``, metres."""
        if self.pitch_rad is not None:
            camera = dataclasses.replace(camera, pitch_rad=self.pitch_rad)
        metres = camera.height_m if self.camera_height_m is None else self.camera_height_m
        ray = camera.ray_directions(height, width, device=device, dtype=dtype)
        right, down, forward = camera.down_direction()
        fall = right * ray[0] + down * ray[1] + forward  # metres fallen per metre of depth
        return torch.where(fall > 0, metres / torch.where(fall > 0, fall, 1.0), torch.inf)[None]


@dataclasses.dataclass(frozen=True, eq=False)
class DepthFromPoints(DepthSource):
    """Depth from a LiDAR cloud: projected, the nearest point of each pixel kept, holes filled in.

    Args:
        points_xyz: ``(N, 3 or more)``, metres in the LiDAR's frame; further columns are ignored, rows at range 0 are
            beams without a return.
        T_camera_from_lidar: ``(4, 4)``, into the camera's frame (x right, y down, z along the axis).
        fill: ``linear`` lays planes between neighbouring points and keeps steps between objects; ``nearest`` gives a
            pixel without a point the depth of the nearest one that has one; ``none`` leaves such pixels at ``inf``.
        above: what stands above the highest point of a column (highest within ``skyline_window_px``): ``sky`` is
            ``inf``, ``nearest`` continues the nearest point, ``auto`` is sky, except where that point lies at the
            scan's upper edge, so that what it hit may go on above.
        skyline_window_px: columns to each side that share a highest point; about twice the beams' spacing.
        upper_edge_rad: how far below the scan's highest elevation a point still counts as its upper edge; more than
            the spacing of the upper beams.

    Note:
        No scan tells a tall house from a lamp that just reaches the upper beam. ``auto`` errs towards the house: real
        sky that is given a depth stays about as bright in fog as it is, a house that is taken for sky vanishes. A
        cloud seen from another place than the camera's shows some background through foreground; the fill does not
        mend that. It runs on the CPU (about a second for 1600 x 900) and carries no gradient.

    Example:
        >>> camera = Camera.from_intrinsics(fx=4, fy=4, cx=1, cy=1, width=4, height=2)
        >>> lidar_axes = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]   # x forward, y left, z up
        >>> wall = torch.tensor([[8.0, 2.0, 2.0], [8.0, 2.0, 0.0]])                  # column 0
        >>> DepthFromPoints(wall, lidar_axes)(camera, 2, 4)
        tensor([[[8., 8., 8., 8.],
                 [8., 8., 8., 8.]]])
    """

    points_xyz: Tensor
    T_camera_from_lidar: Tensor
    fill: str = "linear"
    above: str = "auto"
    skyline_window_px: int = 8
    upper_edge_rad: float = 0.03

    def __post_init__(self) -> None:
        points = torch.as_tensor(self.points_xyz)
        if points.ndim != 2 or points.shape[-1] < 3:
            raise ValueError(
                "DepthFromPoints: points_xyz must have shape (N, 3 or more) = x, y, z in metres; "
                f"got {tuple(points.shape)}."
            )
        if not torch.isfinite(points[:, :3]).all():
            raise ValueError("DepthFromPoints: points_xyz must be finite; got NaN or inf. Drop those rows.")
        transform = torch.as_tensor(self.T_camera_from_lidar, dtype=torch.float64).to(points.device)
        if transform.shape != (4, 4):
            raise ValueError(f"DepthFromPoints: T_camera_from_lidar must be 4 x 4; got {tuple(transform.shape)}.")
        check_one_of("fill", self.fill, ["linear", "nearest", "none"], owner=self)
        check_one_of("above", self.above, ["auto", "sky", "nearest"], owner=self)
        check_at_least("upper_edge_rad", self.upper_edge_rad, 0.0, unit="rad", owner=self)
        check_at_least("skyline_window_px", self.skyline_window_px, 0, unit="px", owner=self)
        object.__setattr__(self, "points_xyz", points[:, :3].to(torch.float64))
        object.__setattr__(self, "T_camera_from_lidar", transform)

    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """Depth ``(1, H, W)``, metres."""
        x_px, y_px, depth, seen = project_points(self.points_xyz, self.T_camera_from_lidar, camera, height, width)
        pixel = (y_px[seen].round() * width + x_px[seen].round()).long()
        nearest = torch.full((height * width,), torch.inf, dtype=torch.float64, device=depth.device)
        nearest = nearest.scatter_reduce(0, pixel, depth[seen], "amin").view(height, width)
        if self.fill != "none":
            if not bool(seen.any()):
                raise ValueError(
                    "DepthFromPoints: no point of the cloud falls into the image, so no hole can be filled; check "
                    "T_camera_from_lidar (metres, into x right, y down, z along the axis) and the intrinsics."
                )
            first = depth[seen] <= nearest.flatten()[pixel]  # the points that stand in the picture
            pixel_xy = torch.stack([x_px, y_px], -1)[seen][first]
            cut_off = torch.zeros_like(nearest, dtype=torch.bool)
            if self.above == "auto":
                cut_off.view(-1)[pixel[self._at_upper_edge(seen)]] = True
            points = self.points_xyz[seen][first] @ self.T_camera_from_lidar[:3, :3].T + self.T_camera_from_lidar[:3, 3]
            nearest = self._filled(nearest, cut_off, pixel_xy, points)
        return nearest.to(device=device, dtype=dtype)[None]

    def _at_upper_edge(self, seen: Tensor) -> Tensor:
        """Which of the seen points belong to the scan's highest elevations."""
        x, y, z = self.points_xyz[seen].unbind(-1)
        elevation = torch.atan2(z, torch.hypot(x, y))
        return elevation > elevation.max() - self.upper_edge_rad

    def _filled(self, depth: Tensor, cut_off: Tensor, pixel_xy: Tensor, points_xyz: Tensor) -> Tensor:
        sparse = depth.cpu().numpy()
        if self.fill == "linear":
            filled = fill_linear(sparse, pixel_xy.cpu().numpy(), points_xyz.cpu().numpy())
        else:
            filled = fill_nearest(sparse)
        if self.above != "nearest":
            filled = paint_sky(filled, np.isfinite(sparse), cut_off.cpu().numpy(), int(self.skyline_window_px))
        return torch.from_numpy(filled)


@dataclasses.dataclass(frozen=True, eq=False)
class DepthFromCallable(DepthSource):
    """Depth by a function of the image, such as a depth network.

    Args:
        function: takes the image ``(..., C, H, W)`` as the caller has it, gives ``(..., 1, H, W)``, metres along the
            optical axis, not a disparity and not up to scale.

    Example:
        >>> brighter_is_nearer = DepthFromCallable(lambda image: 10.0 / image.clamp_min(0.1))
        >>> brighter_is_nearer(Camera.preset("lucid-triton"), 1, 2, image=torch.tensor([[[0.5, 1.0]]]))
        tensor([[[20., 10.]]])
    """

    function: Callable[[Tensor], Tensor]

    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """What the function gives, checked."""
        if image is None:
            raise ValueError("DepthFromCallable: the image is needed; call the source with image=...")
        depth = torch.as_tensor(self.function(image))
        check_depth(depth, height, width, owner="DepthFromCallable")
        return depth.to(device=device, dtype=dtype)


def as_depth_source(depth: object) -> DepthSource:
    """A depth source from whatever a user has.

    Args:
        depth: a source; a number of metres; a map ``(H, W)`` or ``(..., 1, H, W)`` as tensor or array; or a function
            from image to depth.

    Example:
        >>> as_depth_source(30)
        ConstantDepth(depth_m=30.0)
    """
    if isinstance(depth, DepthSource):
        return depth
    if isinstance(depth, (int, float, np.integer, np.floating)) and not isinstance(depth, bool):
        return ConstantDepth(float(depth))
    if isinstance(depth, np.ndarray):
        depth = torch.from_numpy(np.ascontiguousarray(depth))
    if isinstance(depth, Tensor):
        return ConstantDepth(float(depth)) if depth.ndim == 0 else DepthMap(depth)
    if callable(depth):
        return DepthFromCallable(depth)
    raise TypeError(
        "depth must be a number of metres, a map (..., 1, H, W) in metres, a DepthSource such as FlatGround(), or a "
        f"function from image to depth; got {type(depth).__name__}. Read files with torchweather.io.read_depth."
    )


def check_depth(depth_m: Tensor, height: int | None = None, width: int | None = None, *, owner: object) -> None:
    """Raise ``ValueError`` unless a depth map is ``(..., 1, H, W)`` float, 0 m or more, without NaN; ``inf`` is sky.

    The values are not looked at while a graph is traced.
    """
    name = owner if isinstance(owner, str) else type(owner).__name__
    wanted = f"(..., 1, {'H' if height is None else height}, {'W' if width is None else width})"
    wrong_size = height is not None and width is not None and tuple(depth_m.shape[-2:]) != (height, width)
    if depth_m.ndim < 3 or depth_m.shape[-3] != 1 or wrong_size:
        raise ValueError(f"{name}: depth must have shape {wanted}, metres; got {tuple(depth_m.shape)}.")
    if not depth_m.is_floating_point():
        raise TypeError(f"{name}: depth must be floating point, metres; got {depth_m.dtype}.")
    if torch.compiler.is_compiling():
        return
    # One pass without a temporary: the minimum of a map with NaN is NaN.
    if depth_m.numel() and not bool(depth_m.amin() >= 0):
        nan, negative = int(depth_m.isnan().sum()), int((depth_m < 0).sum())
        raise ValueError(
            f"{name}: depth must be 0 m or more along the optical axis, inf for sky; got {nan} NaN and {negative} "
            f"negative of {depth_m.numel()} pixels. Fill unknown pixels (torchweather.io.read_depth has missing_m=)."
        )


def project_points(
    points_xyz: Tensor, T_camera_from_lidar: Tensor, camera: Camera, height: int | None = None, width: int | None = None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Where the points of a cloud fall in an image.

    Args:
        points_xyz: ``(N, 3 or more)``, metres in the LiDAR's frame.
        T_camera_from_lidar: ``(4, 4)``.
        camera: intrinsics and lens distortion.
        height: rows of the image. Default: the camera's.
        width: columns of the image. Default: the camera's.

    Returns:
        Column and row in pixels (float; a pixel's centre is a whole number) and depth in metres, each ``(N,)``, and a
        mask ``(N,)`` of the points whose nearest pixel lies in the image.

    Example:
        >>> camera = Camera.from_intrinsics(fx=10, fy=10, cx=2, cy=1, width=6, height=4)
        >>> project_points(torch.tensor([[0.2, 0.1, 1.0]]), torch.eye(4), camera)
        (tensor([4.]), tensor([2.]), tensor([1.]), tensor([True]))
    """
    rows, columns = height or camera.height, width or camera.width
    transform = T_camera_from_lidar.to(points_xyz)
    in_camera = points_xyz[:, :3] @ transform[:3, :3].T + transform[:3, 3]
    depth = in_camera[:, 2]
    in_front = depth > _NEAREST_POINT_M
    safe_depth = torch.where(in_front, depth, 1.0)
    x, y = in_camera[:, 0] / safe_depth, in_camera[:, 1] / safe_depth
    if camera.distorted:
        # Far outside the picture the distortion polynomial folds back into it: keep to the rays the picture has.
        ray = camera.ray_directions(rows, columns, device=points_xyz.device, dtype=points_xyz.dtype)
        in_front = in_front & (x.square() + y.square() <= 1.02 * ray[:2].square().sum(0).max())
    x, y = camera.distort(x, y)
    cx, cy = camera.principal_point_px
    x_px, y_px = camera.fx * x + cx, camera.fy * y + cy
    seen = in_front & (x_px > -0.5) & (x_px < columns - 0.5) & (y_px > -0.5) & (y_px < rows - 0.5)
    # A range of exactly 0 is a beam without a return, wherever the LiDAR is mounted.
    seen = seen & (points_xyz[:, :3].square().sum(-1) > 0)
    return x_px, y_px, depth, seen
