"""Effects of a camera's window and lens, and of its motion, in the order of the light.

Blurs act on each phase of the CFA, or each colour plane, by itself (``mosaic_blur.py``); lengths are pixels of the
frame. Bounds and typical sizes are orders of magnitude where no source is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.airlight import frame_mean
from torchweather.camera.effects.particles import per_sample
from torchweather.camera.mosaic_blur import blurred_along, disk_points_px, line_points_px, spacing_px
from torchweather.camera.state import CameraState
from torchweather.core.random import Variate
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.tiling import is_exporting

__all__ = ["CameraAdherentDrops", "CameraDefocus", "CameraEgoBlur", "CameraStrayLight", "CameraVignetting"]

DROPS = 24  # on the window; order of magnitude
LARGEST_TO_SMALLEST = 4.0  # areas of the drops
# A drop's edge is as soft as the drop is wide: the lens sees it out of focus. The mask falls from 1 at half of the
# radius to 0 at one and a half; its area over that of the disk:
SOFT_AREA = 13.0 / 12.0


def mean_colours(state: CameraState) -> Tensor:
    """Mean of each colour over the frame, for every pixel of that colour, ``(B, C, H, W)``."""
    cells = state.by_cells(state.image.signal)
    return state.per_pixel(frame_mean(state)).expand(cells.shape).flatten(2, 3)


def reach_of(effect: Effect, parameter: str) -> float:
    """Largest value of a parameter; its bound while a graph is traced, which knows no value."""
    if is_exporting():
        return next(one.high for one in effect.arguments if one.name == parameter)
    value: Tensor = getattr(effect, parameter)
    return float(value.detach().max()) if value.numel() else 0.0


class CameraAdherentDrops(Effect):
    """Drops sit on the window: patches that show the mean of the scene in place of the scene, with soft edges.

    ``(1 - m) I + m mean(I)`` per colour with ``m = 1 - prod(1 - m_k)``. A drop on the window bends in the light of a
    wide field of view, as a falling one does (``PHYSICS.md`` 4.1), and is far out of focus. Twenty-four drops sit
    anywhere; their areas, which differ up to fourfold, are ``-ln(1 - cover)`` of the frame in all, so that they hide
    ``cover`` of it where they overlap by chance.

    Args:
        cover: share of the frame, 0 to 0.9.

    Note:
        They stay where they are as long as the noise does: in ``draw_sequence``, or with the same noise for each frame.
    """

    id: ClassVar[str] = "camera.adherent_drops"
    title: ClassVar[str] = "drops sit on the window"
    term: ClassVar[str] = "adherent raindrops"
    # A windscreen in rain between two strokes of the wiper; order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("cover", "1", 0.0, 0.9, scale=0.1, identity=0.0),)
    after: ClassVar[str] = "particle_veil"
    rank: ClassVar[int] = 0
    axes: ClassVar[tuple[str, ...]] = ("place", "frame")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.defocus": "sharpness against the place in the image: between the drops edges stay sharp",
        "camera.stray_light": "the place in the image: stray light is everywhere",
    }
    # What they hide is a matter of where they sit.
    unmodelled: ClassVar[tuple[str, ...]] = (
        *(f"log_ratio_{what}" for what in ("red", "green", "blue", "spread")),
        *(f"difference_spread_{lag}_px" for lag in ("0_2", "2_0", "2_2", "2_-2", "0_4", "4_0", "8_0", "16_0", "16_4")),
        "difference_spread_16_-4_px",
        *(f"streak_correlation_{lag}_px" for lag in ("2_0", "4_0", "8_0", "16_0", "2_2", "2_-2")),
        *(f"streak_correlation_{lag}_px" for lag in ("4_2", "4_-2", "8_2", "8_-2", "8_4", "8_-4")),
        *("column_correlation", "row_correlation"),
        *(f"shift_{way}_px_{what}" for way in ("across", "down", "outward") for what in ("red", "green", "blue")),
        *(f"edge_contrast_{lag}_px" for lag in ("0_2", "2_0", "2_2", "2_-2", "0_4", "4_0")),
        *(f"{side}_share_{where}" for side in ("bright", "dark") for where in ("near", "far")),
    )
    reads: ClassVar[tuple[str, ...]] = ("image.signal", "receiver.cfa_index")
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def variates(self) -> tuple[Variate, ...]:
        """Column, row and size of each drop."""
        return (Variate("drops", "uniform", (DROPS, 3)),)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The frame behind its drops."""
        mask = self.mask(state, noise["drops"].to(state.image.signal))
        return {"signal": torch.lerp(state.image.signal, mean_colours(state), mask)}

    def mask(self, state: CameraState, drops: Tensor) -> Tensor:
        """Share of each pixel's light that comes through drops, ``(B, 1, H, W)``, from uniforms ``(B, drops, 3)``."""
        height, width = state.image.signal.shape[-2:]
        if not is_exporting() and bool((drops == drops[:1]).all()):
            drops = drops[:1]  # frames of one drive have the same drops
        rows = torch.arange(height, device=drops.device).to(drops.dtype)
        columns = torch.arange(width, device=drops.device).to(drops.dtype)
        area = LARGEST_TO_SMALLEST ** drops[..., 2]
        cover = self.value("cover", area)
        total = -torch.log1p(-cover) * (height * width)
        square = (total * area / area.sum(1, keepdim=True) / (math.pi * SOFT_AREA)).clamp_min(1e-6)  # radius, px^2
        clear = drops.new_ones(())
        for number in range(DROPS):
            u, v = drops[:, number, :1] * width, drops[:, number, 1:2] * height
            # The frame repeats: a drop that leaves it at one edge comes back at the other.
            aside = width / 2 - ((columns - u).abs() - width / 2).abs()
            along = height / 2 - ((rows - v).abs() - height / 2).abs()
            squared = along.square()[:, :, None] + aside.square()[:, None, :]
            ratio = (squared / square[:, number, None, None]).clamp_min(1e-6).sqrt()
            clear = clear * (1.0 - (1.5 - ratio).clamp(0.0, 1.0))
        return (1.0 - clear)[:, None]


class CameraEgoBlur(Effect):
    """The camera moves during the exposure: edges across the motion soften, those along it stay.

    Every pixel becomes the mean along a line of ``length_px`` through it; variance ``length^2 / 12``.

    Args:
        length_px: 0 to 40 px.
        angle_rad: of the motion, from the image's x to its y, which points down.

    Note:
        One motion for the whole picture, as of a turning camera. Cost grows with the square of the length.
    """

    id: ClassVar[str] = "camera.ego_blur"
    title: ClassVar[str] = "the camera moves while it exposes"
    term: ClassVar[str] = "motion blur"
    # 0.1 rad/s of vibration, 5 ms and 2000 px/rad: 1 px; in a turn ten times that.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("length_px", "px", 0.0, 40.0, scale=4.0, identity=0.0),
        Parameter("angle_rad", "rad", -math.pi, math.pi, scale=1.0, default=0.0),
    )
    after: ClassVar[str] = "particle_veil"
    rank: ClassVar[int] = 1
    axes: ClassVar[tuple[str, ...]] = ("edge_direction", "edge_width_px")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.defocus": "edges of several directions: motion softens those across it alone"
    }
    reads: ClassVar[tuple[str, ...]] = ("image.signal", "receiver.cfa_index")
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The smeared frame."""
        length, angle = (per_sample(self, name, state) for name in ("length_px", "angle_rad"))
        reach_px = 0.5 * reach_of(self, "length_px")
        return {"signal": blurred_along(state.image.signal, line_points_px(length, angle), reach_px, spacing_px(state))}


class CameraDefocus(Effect):
    """The lens is out of focus: every edge softens, at all depths alike.

    Every pixel becomes the mean over a disk of ``radius_px`` around it, the circle of confusion; its variance along
    each axis is ``radius^2 / 4``.

    Args:
        radius_px: 0 to 10 px.

    Note:
        Cost grows with the square of the radius.
    """

    id: ClassVar[str] = "camera.defocus"
    title: ClassVar[str] = "the lens is out of focus"
    term: ClassVar[str] = "defocus (circle of confusion)"
    # A wet window or a focus shifted by temperature: a pixel; order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("radius_px", "px", 0.0, 10.0, scale=1.0, identity=0.0),)
    after: ClassVar[str] = "particle_veil"
    rank: ClassVar[int] = 2
    axes: ClassVar[tuple[str, ...]] = ("edge_width_px",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.aerosol_glow": "edges at several depths: a glow leaves near ones sharp",
        "camera.ego_blur": "edges of several directions: motion softens those across it alone",
        "camera.adherent_drops": "sharpness against the place in the image",
    }
    reads: ClassVar[tuple[str, ...]] = ("image.signal", "receiver.cfa_index")
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The soft frame."""
        points_px = disk_points_px(per_sample(self, "radius_px", state))
        return {"signal": blurred_along(state.image.signal, points_px, reach_of(self, "radius_px"), spacing_px(state))}


class CameraVignetting(Effect):
    """The picture grows darker towards its corners: ``I cos(theta)^(4 strength)``, theta from the optical axis.

    A strength of 1 is the natural law, cos^4.

    Args:
        strength: 0 to 10.
    """

    id: ClassVar[str] = "camera.vignetting"
    title: ClassVar[str] = "the corners are darker"
    term: ClassVar[str] = "vignetting (relative illumination)"
    # 1 is the cos^4 law, which the clear frame has already; stops of the lens add about as much, order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("strength", "1", 0.0, 10.0, scale=0.5, identity=0.0),)
    after: ClassVar[str] = "particle_veil"
    rank: ClassVar[int] = 3
    axes: ClassVar[tuple[str, ...]] = ("image_radius",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.exposure_gain": "the ratio against image radius",
        "camera.wet_surface": "walls and the sky in the corners: they are no darker where the road is wet",
    }
    reads: ClassVar[tuple[str, ...]] = ("image.signal", "scene.ray_per_depth")
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal, darker off the axis."""
        strength = self.value("strength", state.image.signal)
        return {"signal": state.image.signal * torch.exp(-4.0 * strength * torch.log(state.scene.ray_per_depth))}


class CameraStrayLight(Effect):
    """Light that forms no image lies over the picture: ``I + offset + share mean(I)``, per colour.

    What the pixels themselves lose to it, at most the same share, is a matter of exposure.

    Args:
        offset: in units of saturation, 0 to 1.
        share: of the mean of the frame, 0 to 1.
    """

    id: ClassVar[str] = "camera.stray_light"
    title: ClassVar[str] = "stray light lies over the picture"
    term: ClassVar[str] = "stray light (veiling glare)"
    # Veiling glare of camera lenses is 1 to 5 % (ISO 9358 measures it); a wet window's is higher.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("offset", "1", 0.0, 1.0, scale=0.02, identity=0.0),
        Parameter("share", "1", 0.0, 1.0, scale=0.03, identity=0.0),
    )
    after: ClassVar[str] = "particle_veil"
    rank: ClassVar[int] = 4
    axes: ClassVar[tuple[str, ...]] = ("intensity", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.airlight_scale": "near surfaces: airlight needs depth, stray light none",
        "camera.tone_curve": "black pixels: a curve leaves them black",
        "camera.adherent_drops": "the place in the image: stray light is everywhere",
    }
    reads: ClassVar[tuple[str, ...]] = ("image.signal", "receiver.cfa_index")
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal under its veil."""
        more = self.value("share", state.image.signal) * mean_colours(state) + self.value("offset", state.image.signal)
        return {"signal": (state.image.signal + more).clamp_max(1.0)}
