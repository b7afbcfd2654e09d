"""Drops on the window in front of a camera that refract: each shows the scene upside down."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.effects.optics import LARGEST_TO_SMALLEST
from torchweather.camera.mosaic_blur import phases, spacing_px, whole
from torchweather.camera.state import CameraState
from torchweather.core.errors import InputValueError
from torchweather.core.random import Variate
from torchweather.lidar.effects.air import WATER_INDEX, transmittance_into_water
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.tiling import is_exporting

__all__ = ["CameraRefractingDrops", "refracted"]

MOST_REACH = 15  # of the means of what a drop shows, in pixels of one colour
BETWEEN_POINTS = 0.43  # of the aperture's radius lies between its points, which the mean over it smooths away
LEAST_BLUR_PX = 0.25  # radius of an aperture that blurs
DROPS = 96  # on the window; order of magnitude
# Points of the aperture through which a pixel sees the window, in a disk of radius 1: the middle and two rings.
APERTURE = (
    (0.0, 0.0),
    *((0.44 * math.cos(k * math.pi / 3), 0.44 * math.sin(k * math.pi / 3)) for k in range(6)),
    *((0.86 * math.cos((k + 0.5) * math.pi / 6), 0.86 * math.sin((k + 0.5) * math.pi / 6)) for k in range(12)),
)


class CameraRefractingDrops(Effect):
    """Drops sit on the window and bend the light: spherical caps in which the scene stands upside down, out of focus.

    A ray goes through the window into the water and leaves it at the cap, by Snell's law; the pixel shows the picture
    in that direction, weaker by Fresnel's transmittance, and nothing where the ray is totally reflected. The camera is
    focused far away: a pixel sees the window through its whole aperture, and so the mean over the aperture of rays that
    meet drops and rays that meet none. Ninety-six drops sit anywhere; their areas, which differ up to fourfold, are
    ``-ln(1 - cover)`` of the frame in all.

    Args:
        cover: share of the frame, 0 to 0.9.
        blur_px: diameter of the aperture as seen on the window, pixels, 0 to 400: aperture over distance of the window
            times the focal length in pixels.
        contact_deg: angle between a drop's edge and the window, 5 to 90 degrees.

    Note:
        The window faces the camera. Of what lies outside of the picture, its edge stands in. They stay where they are
        as long as the noise does. No graph holds it: there is ``camera.adherent_drops``.

    References:
        Roser, Kurz and Geiger 2010, Realistic modeling of water droplets for monocular adherent raindrop recognition
        (ACCV workshops); Halimeh and Roser 2009, IEEE Intelligent Vehicles Symposium.
    """

    id: ClassVar[str] = "camera.refracting_drops"
    title: ClassVar[str] = "drops on the window bend the light"
    term: ClassVar[str] = "adherent raindrops (refraction)"
    searched: ClassVar[bool] = False
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("cover", "1", 0.0, 0.9, scale=0.1, identity=0.0),
        Parameter("blur_px", "px", 0.0, 400.0, scale=20.0, default=0.0),
        Parameter("contact_deg", "deg", 5.0, 90.0, scale=20.0, default=45.0),
    )
    after: ClassVar[str] = "particle_veil"
    rank: ClassVar[int] = 0
    axes: ClassVar[tuple[str, ...]] = ("place", "frame")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.adherent_drops": "what a drop shows: the scene upside down, or the mean of the frame"
    }
    needs: ClassVar[tuple[str, ...]] = ("camera",)
    reads: ClassVar[tuple[str, ...]] = (
        "scene.intrinsics",
        "image.signal",
        *("receiver.camera", "receiver.cfa_index"),
    )
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def variates(self) -> tuple[Variate, ...]:
        """Column, row and size of each drop."""
        return (Variate("drops", "uniform", (DROPS, 3)),)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The frame behind its drops."""
        if is_exporting():
            raise InputValueError(
                "CameraRefractingDrops: no graph can hold it, as it works drop by drop. Leave WetWindow out of the "
                "weather that is exported, or give effects=[CameraAdherentDrops(cover=...)]."
            )
        signal = state.image.signal
        drops = noise["drops"].to(signal)
        cover, blur, contact = (
            self.value(name, signal).reshape(-1).expand(state.batch) for name in ("cover", "blur_px", "contact_deg")
        )
        intrinsics = state.scene.intrinsics.to(signal).expand(state.batch, 4)
        apart = spacing_px(state)
        frames = []
        for sample in range(state.batch):
            found = signal[sample]
            if float(cover[sample]) > 0.0:
                small = self._scene(
                    signal[sample : sample + 1], intrinsics[sample], cover[sample], contact[sample], apart
                )
                where = (small, drops[sample], cover[sample], 0.5 * blur[sample], torch.deg2rad(contact[sample]))
                found = self._behind(state, found, intrinsics[sample], *where)
            frames.append(found)
        return {"signal": torch.stack(frames)}

    def _scene(self, frame: Tensor, intrinsics: Tensor, cover: Tensor, contact_deg: Tensor, apart: int) -> Tensor:
        """The frame ``(C, H, W)`` as small as a drop of mean size shows it: means over what falls on a pixel."""
        height, width = frame.shape[-2:]
        radius = math.sqrt(-math.log1p(-float(cover)) * height * width / DROPS / math.pi)
        steep = math.sin(math.radians(float(contact_deg)))
        smaller = (WATER_INDEX - 1.0) * steep * float(intrinsics[0]) / radius
        reach = min(round(0.5 * smaller / apart), MOST_REACH, min(height, width) // (2 * apart) - 1)
        if reach < 1:
            return frame[0]
        pooled = torch.nn.functional.avg_pool2d(phases(frame, apart), 2 * reach + 1, 1, reach, count_include_pad=False)
        return whole(pooled, apart)[0]

    def _behind(
        self,
        state: CameraState,
        frame: Tensor,
        intrinsics: Tensor,
        scene: Tensor,
        drops: Tensor,
        cover: Tensor,
        blur_px: Tensor,
        contact_rad: Tensor,
    ) -> Tensor:
        """One frame ``(C, H, W)`` behind drops that show a scene; ``blur_px`` is a radius."""
        height, width = frame.shape[-2:]
        area = LARGEST_TO_SMALLEST ** drops[:, 2]
        radius = (-torch.log1p(-cover) * (height * width) * area / area.sum() / math.pi).sqrt()
        steep = torch.sin(contact_rad)
        points = APERTURE if float(blur_px) > LEAST_BLUR_PX else APERTURE[:1]
        aperture = frame.new_tensor(points)[:, None]  # (points, 1, 2)
        apart = spacing_px(state)
        soft = round(float(blur_px) * BETWEEN_POINTS / (2 * apart)) if len(points) > 1 else 0
        out, free = frame.clone(), torch.ones_like(frame[:1])
        for number in range(DROPS):
            size = float(radius[number])
            column, row = float(drops[number, 0]) * width, float(drops[number, 1]) * height
            reach = size + float(blur_px) + apart * soft
            # Whole cells of the mosaic.
            top, bottom = max(0, int(row - reach) // 2 * 2), min(height, int(row + reach) // 2 * 2 + 2)
            left, right = max(0, int(column - reach) // 2 * 2), min(width, int(column + reach) // 2 * 2 + 2)
            if top >= bottom or left >= right:
                continue
            box = (slice(None), slice(top, bottom), slice(left, right))
            rows = torch.arange(top, bottom, device=frame.device).to(frame)[:, None]
            columns = torch.arange(left, right, device=frame.device).to(frame)[None, :]
            ray = self._rays(state, intrinsics, rows, columns)
            u = ((columns + aperture[..., :1] * blur_px - column) / size).expand(-1, len(rows), -1)
            v = ((rows + aperture[..., 1:] * blur_px - row) / size).expand(-1, -1, columns.shape[1])
            inside = (u.square() + v.square() < 1.0).to(frame) / len(aperture)
            seen = self._seen(state, scene, intrinsics, rows, columns, ray, (u, v), steep)
            share, shown = (_soft(one, soft, apart) for one in (inside.sum(0, keepdim=True), (inside * seen).sum(1)))
            kept = (free[box] / share.clamp_min(1e-9)).clamp_max(1.0)  # drops that overlap share the aperture
            out[box] = out[box] + kept * (shown - share * frame[box])
            free[box] = (free[box] - share).clamp_min(0.0)
        return out

    def _rays(self, state: CameraState, intrinsics: Tensor, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
        """x and y of the rays of pixels, per z."""
        camera = state.receiver.camera
        assert camera is not None
        fx, fy, cx, cy = intrinsics
        size = (len(rows), columns.shape[1])
        x, y = ((columns - cx) / fx).expand(size), ((rows - cy) / fy).expand(size)
        return camera.undistort(x, y) if camera.distorted else (x, y)

    def _seen(
        self,
        state: CameraState,
        frame: Tensor,
        intrinsics: Tensor,
        rows: Tensor,
        columns: Tensor,
        ray: tuple[Tensor, Tensor],
        place: tuple[Tensor, Tensor],
        steep: Tensor,
    ) -> Tensor:
        """Scene through a drop at places ``(points, h, w)`` of its disk: ``(C, points, h, w)``."""
        camera = state.receiver.camera
        assert camera is not None
        fx, fy, cx, cy = intrinsics
        (x, y, z), through = refracted(ray, place, steep)
        ahead = z.clamp_min(1e-2)
        x, y = x / ahead, y / ahead
        if camera.distorted:
            x, y = camera.distort(x, y)
        height, width = frame.shape[-2:]
        column, row = (x * fx + cx).clamp(0.0, width - 1.0), (y * fy + cy).clamp(0.0, height - 1.0)
        if state.receiver.cfa_index is None:
            return through * frame[:, row.round().long(), column.round().long()]
        # Of a mosaic, the nearest pixel of the same phase.
        aside, down = columns.long() % 2, rows.long() % 2
        near_column = (2 * ((column - aside) / 2).round().long() + aside).clamp(max=width - 2 + aside)
        near_row = (2 * ((row - down) / 2).round().long() + down).clamp(max=height - 2 + down)
        return through * frame[:, near_row, near_column]


def _soft(image: Tensor, reach: int, apart: int) -> Tensor:
    """Means of a part of a frame ``(C, h, w)`` over so many pixels of its own colour to every side."""
    if not reach:
        return image
    planes = phases(image[None], apart)
    return whole(torch.nn.functional.avg_pool2d(planes, 2 * reach + 1, 1, reach), apart)[0]


def refracted(
    ray: tuple[Tensor, Tensor], place: tuple[Tensor, Tensor], steep: Tensor
) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor]:
    """Direction of rays behind a drop on a window that faces the camera, and the share of light that passes.

    Args:
        ray: x and y of each pixel's ray per z, in the camera's frame.
        place: where it meets the drop, over the drop's radius, x and y.
        steep: sine of the contact angle.

    Returns:
        x, y, z of unit vectors, and Fresnel's transmittance; 0 where the light is totally reflected.

    Example:
        >>> one, zero = torch.tensor([0.5]), torch.zeros(1)
        >>> (x, _, _), through = refracted((zero, zero), (one, zero), torch.tensor(0.87))
        >>> bool(x < 0), bool(through > 0.9)  # the right of a drop shows what lies to the left
        (True, True)
    """
    (x, y), (u, v) = ray, place
    per_z = (1.0 + x.square() + y.square()).rsqrt()
    inner = [x * per_z / WATER_INDEX, y * per_z / WATER_INDEX]  # in the water, behind the window
    inner.append((1.0 - inner[0].square() - inner[1].square()).sqrt())
    outward = [steep * u, steep * v]
    outward.append((1.0 - outward[0].square() - outward[1].square()).clamp_min(1e-12).sqrt())
    cosine = inner[0] * outward[0] + inner[1] * outward[1] + inner[2] * outward[2]
    square = 1.0 - WATER_INDEX**2 * (1.0 - cosine.square())
    leaves = square.clamp_min(1e-12).sqrt()
    turned = leaves - WATER_INDEX * cosine
    x, y, z = (WATER_INDEX * one + turned * other for one, other in zip(inner, outward, strict=True))
    through = torch.where((square > 0) & (cosine > 0), transmittance_into_water(leaves), 0.0)
    return (x, y, z), through
