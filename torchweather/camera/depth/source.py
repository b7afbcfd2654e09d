"""DepthSource: anything that gives the depth of a camera's image; its border checks."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.camera.depth.scene_depth import EXACT, SceneDepth, least_sure
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherWarning
from torchweather.core.masks import compare, ends_of, least_of

__all__ = ["DepthSource", "SceneSource", "check_depth", "scene_of", "warn_of_depth"]

# Share of the lowest third that may be sky: puddles and holes of a renderer are less, a sparse map is more.
_SKY_ON_ROAD = 0.2
# The road before a vehicle's camera is in the picture's lowest third within 20 m, also through a long lens.
_NEAREST_M = 100.0


class DepthSource(ABC):
    """Source of depth for a camera's images.

    Called as ``source(camera, height, width, device=..., dtype=..., image=...)``, it gives ``(..., 1, H, W)``, metres
    along the optical axis, ``inf`` for sky. ``image`` is the frame as the caller has it: sRGB ``(..., 3, H, W)`` or a
    mosaic ``(..., 1, H, W)``; sources that do not look at the picture ignore it. ``scene`` takes the same arguments
    and gives a `SceneDepth`. Positions, lens and mounting come from ``camera``.
    """

    confidence: ClassVar[str] = EXACT
    """Certainty of its depth: ``exact``, ``measured``, ``completed`` or ``guessed``."""
    one_picture: ClassVar[bool] = False
    """True where it looks at one picture ``(C, H, W)`` at a time; a batch is then given to it picture by picture."""

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
        """Depth with sky, own vehicle and confidence, as far as the source has them."""
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
    check_arguments(
        "scene_of(source: DepthSource, camera: Camera, height: int, width: int, image: Tensor, dtype: dtype)",
        source,
        camera,
        height,
        width,
        image,
        dtype,
    )
    device = image.device
    if not source.one_picture or image.ndim <= 3:
        return source.scene(camera, height, width, device=device, dtype=dtype, image=image)
    pictures = image.reshape(-1, *image.shape[-3:])
    scenes = [source.scene(camera, height, width, device=device, dtype=dtype, image=picture) for picture in pictures]
    together: dict[str, Any] = {}
    for name in ("depth_m", "sky", "near_mask", "ground"):
        shares = [getattr(scene, name) for scene in scenes]
        if any(share is not None for share in shares):
            whole = [scene.sky_share if name == "sky" else share for scene, share in zip(scenes, shares, strict=True)]
            filled = [torch.zeros_like(scenes[0].depth_m) if share is None else share for share in whole]
            together[name] = torch.stack(filled).reshape(*image.shape[:-3], 1, height, width)
    notes = tuple(dict.fromkeys(note for scene in scenes for note in scene.notes))
    return SceneDepth(confidence=least_sure(*(scene.confidence for scene in scenes)), notes=notes, **together)


def check_depth(depth_m: Tensor, height: int | None = None, width: int | None = None, *, owner: object) -> None:
    """Raise ``ValueError`` unless a depth map is ``(..., 1, H, W)`` float, above 0 m, without NaN; ``inf`` is sky.

    Nothing stands 0 m before a lens: 0 is how projected LiDARs write "no value", and would stay clear in any fog. The
    values are not looked at while a graph is traced.
    """
    check_arguments("check_depth(depth_m: Tensor, height: int | None, width: int | None)", depth_m, height, width)
    name = owner if isinstance(owner, str) else type(owner).__name__
    wanted = f"(..., 1, {'H' if height is None else height}, {'W' if width is None else width})"
    wrong_size = height is not None and width is not None and tuple(depth_m.shape[-2:]) != (height, width)
    if depth_m.ndim < 3 or depth_m.shape[-3] != 1 or wrong_size:
        raise InputValueError(f"{name}: depth must have shape {wanted}, metres; got {tuple(depth_m.shape)}.")
    if not depth_m.is_floating_point():
        raise InputTypeError(f"{name}: depth must be floating point, metres; got {depth_m.dtype}.")
    if torch.compiler.is_compiling():
        return
    if depth_m.numel() and not least_of(depth_m) > 0:  # NaN is not
        nan, zero, negative = int(depth_m.isnan().sum()), int((depth_m == 0).sum()), int((depth_m < 0).sum())
        remedy = "Complete maps with unknown pixels: CompletedDepthMap(depth)."
        if zero and not nan and not negative:
            raise InputValueError(
                f"{name}: depth must be above 0 m along the optical axis, inf for sky; got 0 m in {zero} of "
                f"{depth_m.numel()} pixels ({zero / depth_m.numel():.1%}), which is how sparse maps write no value. "
                f"{remedy}"
            )
        raise InputValueError(
            f"{name}: depth must be above 0 m along the optical axis, inf for sky; got {nan} NaN, {negative} "
            f"negative and {zero} zero of {depth_m.numel()} pixels. {remedy}"
        )


def warn_of_depth(depth_m: Tensor, camera: Camera, owner: object) -> None:
    """Warn of a map whose sky reaches the road, or that is farther away than any street.

    Args:
        depth_m: ``(..., 1, H, W)`` metres, ``inf`` is sky; NaN is unknown.
        camera: gives the horizon.
        owner: for the message.

    Note:
        It looks at the lowest third of the picture, for sky where that lies below the horizon. A map that is sky alone
        is meant so. Values are not looked at while a graph is traced.
    """
    if torch.compiler.is_compiling() or not depth_m.numel():
        return
    name = owner if isinstance(owner, str) else type(owner).__name__
    height = depth_m.shape[-2]
    depth_m = depth_m.detach()
    low = depth_m[..., height * 2 // 3 :, :]
    nearest, farthest = ends_of(low)
    share = 0.0 if farthest < torch.inf else int(compare(low, ">=", torch.inf).sum()) / low.numel()
    if share > _SKY_ON_ROAD and _below_horizon(camera, height * 2 // 3 / height):
        whole = float(torch.isinf(depth_m).float().mean())
        if whole < 1:
            warnings.warn(
                f"{name}: {whole:.1%} of the depth map is infinite and counts as sky, also {share:.1%} of its lowest "
                "third, which shows the road. If infinity marks pixels without a value, write NaN there and complete "
                "the map: CompletedDepthMap(depth).",
                TorchweatherWarning,
                stacklevel=3,
            )
    nearest_m = nearest if nearest == nearest else float(torch.where(low.isnan(), torch.inf, low).amin())
    if _NEAREST_M < nearest_m < torch.inf and not bool((low == nearest_m).all()):
        warnings.warn(
            f"{name}: nothing in the lowest third of the depth map is nearer than {nearest_m:.4g} m, where a street is "
            "a few metres away. Depth is metres along the optical axis: divide centimetres by 100, millimetres by "
            "1000.",
            TorchweatherWarning,
            stacklevel=3,
        )


def _below_horizon(camera: Camera, share: float) -> bool:
    """True where all rows from this share of the height on lie below the horizon at both edges of the picture."""
    right, down, forward = camera.down_direction()
    cx, cy = camera.principal_point_px
    y = (share * camera.height - cy) / camera.fy
    return all(right * (u - cx) / camera.fx + down * y + forward > 0 for u in (0.0, camera.width - 1.0))
