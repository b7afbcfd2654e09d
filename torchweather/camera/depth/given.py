"""Depth that is given: one number, a map, a function of the image."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.depth.scene_prior import ScenePrior
from torchweather.camera.depth.source import DepthSource, check_depth, warn_of_depth
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_between

AUTO = "auto"
"""Names the depth that is guessed from the picture."""

__all__ = ["AUTO", "ConstantDepth", "DepthFromCallable", "DepthMap", "as_depth_source"]


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
        check_arguments("ConstantDepth(depth_m: float)", self.depth_m)
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
        check_between("height", height, 1, 1 << 24, unit="px", owner=self)
        check_between("width", width, 1, 1 << 24, unit="px", owner=self)
        return torch.full((1, height, width), float(self.depth_m), device=device, dtype=dtype)


@dataclasses.dataclass(frozen=True, eq=False)
class DepthMap(DepthSource):
    """Depth that is known already: a stereo result, a renderer's buffer.

    Args:
        depth_m: ``(H, W)`` or ``(..., 1, H, W)``, metres along the optical axis, above 0; ``inf`` is sky.
            `CompletedDepthMap` takes maps in which 0 or NaN is no value.

    Example:
        >>> DepthMap(torch.full((2, 2), 5.0))(Camera.preset("lucid-triton"), 2, 2).shape
        torch.Size([1, 2, 2])
    """

    depth_m: Tensor

    def __post_init__(self) -> None:
        check_arguments("DepthMap(depth_m: real | array)", self.depth_m)
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
            raise InputValueError(
                f"DepthMap: depth must have the image's size, {height} x {width}; got "
                f"{self.depth_m.shape[-2]} x {self.depth_m.shape[-1]}. Resize it by nearest neighbour: an average "
                "across an edge is a depth where nothing is."
            )
        warn_of_depth(self.depth_m, camera, self)
        return self.depth_m.to(device=device, dtype=dtype)


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
        """Depth that the function returns, checked."""
        if image is None:
            raise InputValueError("DepthFromCallable: the image is needed; call the source with image=...")
        depth = torch.as_tensor(self.function(image))
        check_depth(depth, height, width, owner="DepthFromCallable")
        return depth.to(device=device, dtype=dtype)


def as_depth_source(depth: object) -> DepthSource:
    """A depth source from whatever a user has.

    Args:
        depth: a source; a number of metres; a map ``(H, W)`` or ``(..., 1, H, W)`` as tensor or array; a function
            from image to depth; or ``auto``, guessed from the picture by `ScenePrior`.

    Example:
        >>> as_depth_source(30)
        ConstantDepth(depth_m=30.0)
    """
    if isinstance(depth, DepthSource):
        return depth
    if isinstance(depth, str) and depth == AUTO:
        return ScenePrior()
    if isinstance(depth, (int, float, np.integer, np.floating)) and not isinstance(depth, bool):
        return ConstantDepth(float(depth))
    if isinstance(depth, np.ndarray):
        check_arguments("as_depth_source(depth: array)", depth)
        depth = torch.from_numpy(np.ascontiguousarray(depth, dtype=depth.dtype.newbyteorder("=")))
    if isinstance(depth, Tensor):
        return ConstantDepth(float(depth)) if depth.ndim == 0 else DepthMap(depth)
    if callable(depth):
        return DepthFromCallable(depth)
    raise InputTypeError(
        "depth must be a number or a map (..., 1, H, W) in metres, a DepthSource (FlatGround(), ...), 'auto' or a "
        f"function from image to depth; got {type(depth).__name__}. Read files with torchweather.io.read_depth."
    )
