"""Depth of a street photograph without any measurement: ground, side walls, skyline, boxes, own vehicle."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.depth.horizon import Horizon, below_the_sky, find_horizon, horizon_of_camera
from torchweather.camera.depth.near_mask import find_near_mask
from torchweather.camera.depth.object_boxes import paint_boxes
from torchweather.camera.depth.scene_depth import GUESSED, SceneDepth
from torchweather.camera.depth.source import SceneSource
from torchweather.camera.depth.street_walls import (
    ground_probability,
    guessed_farthest_m,
    guessed_half_width_m,
    sky_shares,
    street_depth,
    view_of_street,
)
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_one_of, check_positive

__all__ = ["ScenePrior"]

# Mean share of sky above the horizon of the KITTI frames that the street was chosen on, for want of a picture.
_USUAL_SKY = 0.17
# Depth of the own vehicle: nearer than a metre from behind the windscreen (PHYSICS 10.12).
_OWN_VEHICLE_M = 1.0
# A box that brings a pixel nearer than this share of the plain street's depth hides the ground.
_OF_OBJECT = 0.97
_UNLIKELY = 0.15  # probability below which the filter may not carry ground, towards the horizon
# Guided filter of the ground's border along the picture's edges: window as a share of the width, variance of the
# picture below which it is flat, and thinning.
_EDGE_SHARE, _EDGE_EPS, _EDGE_SUBSAMPLE = 0.05, 1e-3, 4


@dataclasses.dataclass(frozen=True, eq=False)
class ScenePrior(SceneSource):
    """Guessed depth of a street photograph.

    The scene is flat ground, a wall on each side of the street and a far end (`street_depth`). The picture gives the
    horizon and the street's direction (straight edges), the sky, and the own bonnet; the share of sky gives the
    street's width. Each of them can be given instead.

    Args:
        street_half_width_m: from the camera to the houses or trees, metres: one number, or left and right. Default:
            5 m and 8 m times the side's share of sky. No other number improves the depth as much.
        camera_height_m: above the ground. Default: the camera's ``height_m``.
        farthest_m: depth of the street's far end. Default: 30 m and 120 m times the share of sky.
        boxes: ``(N, 4)``, left, top, right, bottom in pixels, of objects that stand on the ground (labels, a
            detector); the lower edge gives their depth. ``None``: no objects.
        sky: ``(1, H, W)`` share of sky of each pixel, or a function that makes it from the picture. ``None``:
            `sky_mask`.
        near_mask: ``auto`` looks for the own bonnet; ``(1, H, W)`` gives the own vehicle's share of each pixel;
            ``None``: there is none in view.
        horizon: ``auto`` looks for the vanishing point in the picture; where edges say nothing, the camera's own pitch
            stands, or the lowest sky where that is lower. ``camera`` keeps the camera's own pitch.

    Note:
        The confidence is ``guessed``. At the LiDAR's returns of 13 KITTI frames the median error is 11 %, and 91 % of
        the depths are within a factor of 2. Worst: a narrow alley, trees set back far, a vehicle beside the camera
        without its box.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=50, cy=30, width=101, height=61, height_m=1.5)
        >>> scene = ScenePrior(street_half_width_m=6.0, farthest_m=60.0).scene(camera, 61, 101)
        >>> scene.depth_m[0, [30, 60], [50, 50]].round(decimals=1)
        tensor([59.6000,  5.0000])
        >>> print(scene.notes[0])
        depth is guessed: flat ground 1.5 m below the camera, side walls 6 m to the left and 6 m to the right,
        nothing farther than 60 m
    """

    confidence: ClassVar[str] = GUESSED
    one_picture: ClassVar[bool] = True

    street_half_width_m: float | tuple[float, float] | None = None
    camera_height_m: float | None = None
    farthest_m: float | None = None
    boxes: Tensor | None = None
    sky: Tensor | Callable[[Tensor], Tensor] | None = None
    near_mask: Tensor | str | None = "auto"
    horizon: str = "auto"

    def __post_init__(self) -> None:
        check_arguments(
            "ScenePrior(street_half_width_m: float | Sequence[float] | None, camera_height_m: float | None, "
            "farthest_m: float | None, boxes: Tensor | None, sky: Tensor | Callable | None, "
            "near_mask: Tensor | str | None, horizon: str)",
            self.street_half_width_m,
            self.camera_height_m,
            self.farthest_m,
            self.boxes,
            self.sky,
            self.near_mask,
            self.horizon,
        )
        width = self.street_half_width_m
        if width is not None:
            width = width.tolist() if isinstance(width, (Tensor, np.ndarray)) else width
            sides = tuple(width) if isinstance(width, Sequence) else (width, width)
            if len(sides) != 2:
                raise InputValueError(
                    f"ScenePrior.street_half_width_m: expected metres, or (left, right) in metres; got {width!r}."
                )
            for side in sides:
                check_positive("street_half_width_m", side, unit="m", owner=self)
            object.__setattr__(self, "street_half_width_m", (float(sides[0]), float(sides[1])))
        for name in ("camera_height_m", "farthest_m"):
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name), unit="m", owner=self)
        check_one_of("horizon", self.horizon, ("auto", "camera"), owner=self)
        if isinstance(self.near_mask, str):
            check_one_of("near_mask", self.near_mask, ("auto",), owner=self)
        if self.boxes is not None:
            check_arguments("ScenePrior(boxes: Nested)", self.boxes)
            boxes = torch.as_tensor(self.boxes, dtype=torch.float32)
            if boxes.ndim != 2 or boxes.shape[-1] != 4:
                raise InputValueError(
                    f"ScenePrior.boxes: expected (N, 4) = left, top, right, bottom in pixels; got {tuple(boxes.shape)}."
                )
            if not bool(torch.isfinite(boxes).all() & (boxes[:, 2:] >= boxes[:, :2]).all()):
                raise InputValueError(
                    "ScenePrior.boxes: expected left <= right and top <= bottom, finite, pixels; got others. "
                    "Convert (x, y, width, height) to (x, y, x + width, y + height)."
                )
            object.__setattr__(self, "boxes", boxes)

    @torch.no_grad()
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
        """Depth with sky, own vehicle, horizon and notes.

        Args:
            camera: intrinsics, lens distortion, mounting.
            height: rows.
            width: columns.
            device: of the result. Default: the image's.
            dtype: of the result.
            image: sRGB ``(3, H, W)``, uint8 or float 0..1. A mosaic ``(1, H, W)`` is not looked at.

        Returns:
            Without a picture: ground and walls from the camera alone, and no sky unless it is given.
        """
        if image is not None and (image.ndim != 3 or tuple(image.shape[-2:]) != (height, width)):
            raise InputValueError(
                f"ScenePrior: expected one image (3, {height}, {width}); got {tuple(image.shape)}. "
                "Call it for each picture of a batch (scene_of does)."
            )
        device = image.device if device is None and image is not None else device
        return self._one(camera, height, width, image, device).to(device, dtype)

    def _one(
        self, camera: Camera, height: int, width: int, image: Tensor | None, device: torch.device | str | None
    ) -> SceneDepth:
        rgb = None if image is None or image.shape[0] != 3 else image
        horizon, notes = self._horizon(rgb, camera)
        uncertain = rgb is not None and self.horizon == "auto" and horizon.confidence == 0
        sky = self._share("sky", self._sky(rgb, horizon, uncertain=uncertain), height, width, device)
        if uncertain and sky is not None:
            horizon, lower = below_the_sky(horizon, sky, camera)
            notes += [f"the sky reaches below that row: the horizon is taken at row {horizon.row:.0f}"] if lower else []
        view = view_of_street(camera, height, width, horizon.pitch_rad, horizon.heading_rad, device)
        near = self._share("near_mask", self._near(rgb), height, width, device)
        if sky is not None and near is not None:
            sky = sky * (1.0 - near)
        shares = (_USUAL_SKY,) * 3 if sky is None else sky_shares(view, sky)
        metres = camera.height_m if self.camera_height_m is None else self.camera_height_m
        given = self.street_half_width_m
        sides = (guessed_half_width_m(shares[0]), guessed_half_width_m(shares[1])) if given is None else given
        assert isinstance(sides, tuple)  # made one in __post_init__
        farthest = guessed_farthest_m(shares[2]) if self.farthest_m is None else self.farthest_m
        notes.insert(
            0,
            f"depth is guessed: flat ground {metres:.3g} m below the camera, side walls {sides[0]:.3g} m to the left "
            f"and {sides[1]:.3g} m to the right, nothing farther than {farthest:.3g} m",
        )
        depth = street_depth(view, metres, sides, farthest, sky, shares)
        of_street = ground = ground_probability(depth, view, metres)
        if self.boxes is not None:
            plain = depth
            depth, used = paint_boxes(depth, view.fall, self.boxes.to(depth.device), metres, farthest)
            ground = ground * (depth >= _OF_OBJECT * plain)
            notes.append(f"{used} of {len(self.boxes)} boxes stand on the ground and give the depth of objects")
        if rgb is not None:
            ground = along_edges(ground, rgb.to(ground.device)) * (of_street / _UNLIKELY).clamp(max=1.0)
        if sky is not None:
            ground = ground * (1.0 - sky)
        if near is not None:
            ground = ground * (1.0 - near)
            depth = torch.where(near > 0.5, depth.clamp(max=_OWN_VEHICLE_M), depth)
            if bool((near > 0).any()):
                notes.append(f"the own vehicle covers {100 * float(near.mean()):.1f} % of the picture")
        if sky is not None:
            depth = torch.where(sky >= 1.0, torch.inf, depth)
        return SceneDepth(
            depth[None],
            GUESSED,
            sky=None if sky is None else sky[None],
            near_mask=None if near is None else near[None],
            ground=ground[None],
            horizon_row=horizon.row if horizon.confidence > 0 else None,
            notes=tuple(notes),
        )

    def _horizon(self, rgb: Tensor | None, camera: Camera) -> tuple[Horizon, list[str]]:
        if rgb is None:
            return horizon_of_camera(camera), ["no colour picture was given: the horizon is the camera's own"]
        if self.horizon == "camera":
            return horizon_of_camera(camera), ["the horizon is the camera's own"]
        horizon = find_horizon(rgb, camera)
        if horizon.confidence == 0:
            return horizon, ["the picture's edges do not determine the horizon: it is the camera's own"]
        found = f"row {horizon.row:.0f}, confidence {horizon.confidence:.2f}"
        return horizon, [f"the horizon is that of the picture's straight edges: {found}"]

    def _near(self, rgb: Tensor | None) -> Tensor | None:
        if isinstance(self.near_mask, Tensor):
            return self.near_mask
        return None if self.near_mask is None or rgb is None else find_near_mask(rgb)

    def _sky(self, rgb: Tensor | None, horizon: Horizon, *, uncertain: bool) -> Tensor | None:
        if isinstance(self.sky, Tensor):
            return self.sky
        if rgb is None:
            return None
        if self.sky is not None:
            return torch.as_tensor(self.sky(rgb))
        from torchweather.camera.depth.sky import sky_mask

        row = None if uncertain else horizon.row
        found: Tensor = sky_mask(rgb, horizon_row=row, vanishing_column=horizon.column)
        return found

    def _share(
        self, name: str, share: Tensor | None, height: int, width: int, device: torch.device | str | None
    ) -> Tensor | None:
        """A given or found share as ``(H, W)``, checked."""
        if share is None:
            return None
        if share.shape[-2:] != (height, width) or share.numel() != height * width:
            raise InputValueError(
                f"ScenePrior.{name}: expected the picture's size (1, {height}, {width}); got {tuple(share.shape)}."
            )
        share = share.reshape(height, width).to(device=device, dtype=torch.float32)
        if not bool((share >= 0).all() & (share <= 1).all()):
            raise InputValueError(
                f"ScenePrior.{name}: expected shares 0..1; got values outside. Divide 8-bit masks by 255."
            )
        return share


def along_edges(ground: Tensor, rgb: Tensor) -> Tensor:
    """The ground's soft border ``(H, W)`` drawn along the edges of a picture ``(3, H, W)``: guided filter."""
    from kornia.filters import guided_blur

    size = 2 * round(_EDGE_SHARE * rgb.shape[-1] / 2) + 1
    if min(rgb.shape[-2:]) <= size or size < 2 * _EDGE_SUBSAMPLE:  # the filter's reflected border needs more
        return ground
    guide = rgb.to(ground) / (255.0 if rgb.dtype == torch.uint8 else 1.0)
    found: Tensor = guided_blur(guide[None], ground[None, None], size, _EDGE_EPS, subsample=_EDGE_SUBSAMPLE)
    return found[0, 0].clamp(0.0, 1.0)
