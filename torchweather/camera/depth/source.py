"""DepthSource: anything that gives the depth of a camera's image; its border checks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.camera.depth.scene_depth import EXACT, SceneDepth, least_sure
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputTypeError, InputValueError

__all__ = ["DepthSource", "SceneSource", "check_depth", "scene_of"]


class DepthSource(ABC):
    """Anything that knows the depth of a camera's image.

    Called as ``source(camera, height, width, device=..., dtype=..., image=...)``, it gives ``(..., 1, H, W)``, metres
    along the optical axis, ``inf`` for sky. ``image`` is the frame as the caller has it: sRGB ``(..., 3, H, W)`` or a
    mosaic ``(..., 1, H, W)``; sources that do not look at the picture ignore it. ``scene`` takes the same arguments
    and gives a `SceneDepth`. Positions, lens and mounting come from ``camera``.
    """

    confidence: ClassVar[str] = EXACT
    """How sure its depth is: ``exact``, ``measured``, ``completed`` or ``guessed``."""
    one_picture: ClassVar[bool] = False
    """Whether it looks at one picture ``(C, H, W)`` at a time; a batch is then given to it picture by picture."""

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

    def scene(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> SceneDepth:
        """Depth with what else the source knows: sky, own vehicle, confidence."""
        depth_m = self(camera, height, width, device=device, dtype=dtype, image=image)
        return SceneDepth(depth_m, self.confidence)


class SceneSource(DepthSource):
    """A source that finds the scene, of which its depth is a part."""

    @abstractmethod
    def scene(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> SceneDepth:
        """Depth, sky, own vehicle and confidence."""

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
        """Depth ``(..., 1, H, W)``, metres; ``inf`` where a pixel is sky alone."""
        return self.scene(camera, height, width, device=device, dtype=dtype, image=image).depth_m


def scene_of(
    source: DepthSource,
    camera: Camera,
    height: int,
    width: int,
    *,
    image: Tensor,
    dtype: torch.dtype = torch.float32,
) -> SceneDepth:
    """The scene in front of a picture or a batch of pictures ``(..., C, H, W)``.

    A source that looks at one picture at a time is asked for each of the batch.
    """
    device = image.device
    if not source.one_picture or image.ndim <= 3:
        return source.scene(camera, height, width, device=device, dtype=dtype, image=image)
    pictures = image.reshape(-1, *image.shape[-3:])
    scenes = [source.scene(camera, height, width, device=device, dtype=dtype, image=picture) for picture in pictures]
    together: dict[str, Any] = {}
    for name in ("depth_m", "sky", "near_mask"):
        shares = [getattr(scene, name) for scene in scenes]
        if any(share is not None for share in shares):
            whole = [scene.sky_share if name == "sky" else share for scene, share in zip(scenes, shares, strict=True)]
            filled = [torch.zeros_like(scenes[0].depth_m) if share is None else share for share in whole]
            together[name] = torch.stack(filled).reshape(*image.shape[:-3], 1, height, width)
    notes = tuple(dict.fromkeys(note for scene in scenes for note in scene.notes))
    return SceneDepth(confidence=least_sure(*(scene.confidence for scene in scenes)), notes=notes, **together)


def check_depth(depth_m: Tensor, height: int | None = None, width: int | None = None, *, owner: object) -> None:
    """Raise ``ValueError`` unless a depth map is ``(..., 1, H, W)`` float, 0 m or more, without NaN; ``inf`` is sky.

    The values are not looked at while a graph is traced.
    """
    name = owner if isinstance(owner, str) else type(owner).__name__
    wanted = f"(..., 1, {'H' if height is None else height}, {'W' if width is None else width})"
    wrong_size = height is not None and width is not None and tuple(depth_m.shape[-2:]) != (height, width)
    if depth_m.ndim < 3 or depth_m.shape[-3] != 1 or wrong_size:
        raise InputValueError(f"{name}: depth must have shape {wanted}, metres; got {tuple(depth_m.shape)}.")
    if not depth_m.is_floating_point():
        raise InputTypeError(f"{name}: depth must be floating point, metres; got {depth_m.dtype}.")
    if torch.compiler.is_compiling():
        return
    # One pass without a temporary: the minimum of a map with NaN is NaN.
    if depth_m.numel() and not bool(depth_m.amin() >= 0):
        nan, negative = int(depth_m.isnan().sum()), int((depth_m < 0).sum())
        raise InputValueError(
            f"{name}: depth must be 0 m or more along the optical axis, inf for sky; got {nan} NaN and {negative} "
            f"negative of {depth_m.numel()} pixels. Complete maps with unknown pixels: CompletedDepthMap(depth)."
        )
