"""Lamps that a night frame shows: bright spots, their place, colour and the light beyond saturation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from scipy import ndimage

from torchweather.camera.night.lamps import Lamp, Night, beam_share
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState

__all__ = ["LampInView", "found_lamps", "lamp_in_view"]

Array = npt.NDArray[np.float64]

BRIGHT = 0.85  # of saturation, the brightest colour of a lamp's pixels
LARGEST_SHARE = 0.005  # of the frame; a larger bright area is a lit wall or a sign
SMALLEST_PX = 2  # a single bright pixel is noise
RED_OVER_GREEN = 1.8
SURE_RING = 0.2  # of saturation, mean of a ring whose colour is that of the lamp
RING_PX = 2  # around a spot, where its colour is not saturated
NEAREST_M, FARTHEST_M = 2.0, 300.0


@dataclass(frozen=True)
class LampInView:
    """A lamp and the pixels that show it.

    Args:
        lamp: in the vehicle's frame, shining at the camera.
        rows, columns: of its pixels, ``(n,)``.
        depth_m: along the optical axis.
        signal: light of each of its pixels per colour, linear, saturation 1: beyond 1 where the frame is saturated.
    """

    lamp: Lamp
    rows: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]
    depth_m: float
    signal: tuple[float, float, float]


def found_lamps(state: CameraState, sample: int, night: Night, camera: Camera) -> list[LampInView]:
    """Lamps among the bright spots of a frame.

    A spot is what exceeds 0.85 of saturation in one colour, 2 px to half a percent of the frame. Its colour is that of
    the ring around it. A red one gets the intensity of a tail lamp, any other that of a white lamp. In front of the sky
    its distance is that of a street lamp of the given height; elsewhere the nearest depth of its pixels. A spot where a
    white thing in the own headlamps would be as bright is none.

    Args:
        state: the frames.
        sample: which of them.
        night: intensities and height of found lamps.
        camera: that took them.
    """
    colours = _colour_planes(state, sample)
    spots, _ = ndimage.label(colours.max(0) >= BRIGHT, structure=np.ones((3, 3)))
    depth = state.scene.depth_m[min(sample, len(state.scene.depth_m) - 1), 0].detach().cpu().double().numpy()
    found = []
    for index, window in enumerate(ndimage.find_objects(spots), 1):
        inside = spots[window] == index
        if not SMALLEST_PX <= inside.sum() <= LARGEST_SHARE * spots.size:
            continue
        rows, columns = (axis + part.start for axis, part in zip(np.nonzero(inside), window, strict=True))
        tint = _ring_colour(colours, spots, window)
        red = tint[0] > RED_OVER_GREEN * max(tint[1], 1e-6)
        u_px, v_px = float(columns.mean()), float(rows.mean())
        depth_m = _depth_of(depth[rows, columns], u_px, v_px, camera, night)
        intensity = night.red_lamp_cd if red else night.white_lamp_cd
        lamp = Lamp(_place(u_px, v_px, depth_m, camera), intensity, heading_rad=math.pi, colour=tint)
        if _lit_by(night.own_lamps, lamp) > BRIGHT * math.pi * night.saturation_cd_per_m2:
            continue  # as bright as a white thing in the own headlamps
        found.append(LampInView(lamp, rows, columns, depth_m, _signal(lamp, len(rows), camera, night)))
    return found


def lamp_in_view(
    lamp: Lamp, size: tuple[int, int], camera: Camera, night: Night, *, mosaic: bool = False
) -> LampInView | None:
    """The pixels that show a given lamp; ``None`` where it is behind the camera or outside of the picture.

    Args:
        lamp: in the vehicle's frame.
        size: rows and columns.
        camera: that takes the frame.
        night: luminance that saturates it.
        mosaic: whole cells of a mosaic show it, so that each colour gets its share.
    """
    rotation = np.array(camera.camera_from_vehicle())
    x, y, z = rotation @ (np.array(lamp.position_m) - [0.0, 0.0, camera.height_m])
    if z < 0.1:
        return None
    xd, yd = camera.distort(torch.tensor(x / z), torch.tensor(y / z))
    cx, cy = camera.principal_point_px
    u_px, v_px = float(xd) * camera.fx + cx, float(yd) * camera.fy + cy
    height, width = size
    if not (-0.5 <= u_px < width - 0.5 and -0.5 <= v_px < height - 0.5):
        return None
    radius = max(lamp.radius_m * camera.fx / z, 0.6)
    row, column = np.mgrid[0:height, 0:width][:, _near(v_px, radius, height), _near(u_px, radius, width)]
    inside = np.hypot(row - v_px, column - u_px) <= radius
    if not inside.any():
        inside = np.hypot(row - v_px, column - u_px) <= 1.0
    rows, columns = row[inside], column[inside]
    if mosaic:
        cells = np.unique(np.stack([rows // 2, columns // 2]), axis=1)
        rows = (2 * cells[0][:, None] + np.array([0, 0, 1, 1])).reshape(-1)
        columns = (2 * cells[1][:, None] + np.array([0, 1, 0, 1])).reshape(-1)
    return LampInView(lamp, rows, columns, float(z), _signal(lamp, len(rows), camera, night))


def _near(middle: float, reach: float, size: int) -> slice:
    return slice(max(0, math.floor(middle - reach) - 1), min(size, math.ceil(middle + reach) + 2))


def _colour_planes(state: CameraState, sample: int) -> Array:
    """Red, green, blue of every pixel, ``(3, H, W)``; of a mosaic, those of its cell."""
    signal = state.image.signal[sample].detach().cpu().double().numpy()
    if state.receiver.cfa_index is None:
        return np.asarray(signal)
    index = state.receiver.cfa_index.cpu().numpy()
    cells = {c: [signal[0, y::2, x::2] for y in (0, 1) for x in (0, 1) if index[y, x] == c] for c in range(3)}
    planes = [np.mean(cells[c], axis=0) for c in range(3)]
    return np.stack([plane.repeat(2, 0).repeat(2, 1) for plane in planes])


def _ring_colour(colours: Array, spots: Array, window: tuple[slice, slice]) -> tuple[float, float, float]:
    """Mean colour around a spot, scaled to a mean of 1; the whiter, the darker the ring."""
    wide = tuple(slice(max(0, part.start - RING_PX), part.stop + RING_PX) for part in window)
    ring = spots[wide] == 0
    if not ring.any():
        return 1.0, 1.0, 1.0
    mean = colours[(slice(None), *wide)][:, ring].mean(1)
    sure = min(mean.mean() / SURE_RING, 1.0)  # a dark ring shows what is behind the lamp
    red, green, blue = (1.0 + sure * (mean / max(mean.mean(), 1e-6) - 1.0)).tolist()
    return red, green, blue


def _depth_of(depth_m: Array, u_px: float, v_px: float, camera: Camera, night: Night) -> float:
    known = depth_m[np.isfinite(depth_m)]
    if known.size:
        return float(np.clip(known.min(), NEAREST_M, FARTHEST_M))
    direction = _direction(u_px, v_px, camera)  # per metre of depth
    rise = direction[2]
    if rise <= 1e-3:
        return FARTHEST_M
    return float(np.clip((night.street_lamp_height_m - camera.height_m) / rise, NEAREST_M, FARTHEST_M))


def _direction(u_px: float, v_px: float, camera: Camera) -> Array:
    """Forward, left, up per metre of depth."""
    cx, cy = camera.principal_point_px
    x, y = camera.undistort(torch.tensor((u_px - cx) / camera.fx), torch.tensor((v_px - cy) / camera.fy))
    return np.asarray(np.array(camera.camera_from_vehicle()).T @ np.array([float(x), float(y), 1.0]))


def _place(u_px: float, v_px: float, depth_m: float, camera: Camera) -> tuple[float, float, float]:
    forward, left, up = (depth_m * _direction(u_px, v_px, camera)).tolist()
    return forward, left, up + camera.height_m


def _lit_by(own: Sequence[Lamp], at: Lamp) -> float:
    """Illuminance by the own headlamps, lux, at the place of a lamp."""
    lux = 0.0
    for lamp in own:
        offset = np.array(at.position_m) - lamp.position_m
        lux += _candela_towards(lamp, offset) / max(float((offset**2).sum()), 0.01)
    return lux


def _candela_towards(lamp: Lamp, offset: Array) -> float:
    """Luminous intensity of a lamp in the direction of an offset from it, cd."""
    forward, left, up = offset.tolist()
    azimuth = math.atan2(left, forward) - lamp.heading_rad
    azimuth = math.atan2(math.sin(azimuth), math.cos(azimuth))
    elevation = math.atan2(up, math.hypot(forward, left)) - lamp.tilt_rad
    angles = (torch.tensor(angle, dtype=torch.float64) for angle in (azimuth, elevation))
    return lamp.intensity_cd * float(beam_share(lamp.beam, *angles))


def _signal(lamp: Lamp, pixels: int, camera: Camera, night: Night) -> tuple[float, float, float]:
    """Mean light of each pixel: the illuminance ``I / R^2``, spread over the solid angle of the pixels."""
    offset = np.array([0.0, 0.0, camera.height_m]) - lamp.position_m
    square_m2 = float((offset**2).sum())
    solid_angle_sr = pixels / (camera.fx * camera.fy)
    level = _candela_towards(lamp, offset) / square_m2 / solid_angle_sr / night.saturation_cd_per_m2
    red, green, blue = (level * one for one in lamp.colour)
    return red, green, blue
