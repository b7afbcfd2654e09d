"""An embedded scene as the raw frame that a camera delivers of it in clear air."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.camera.bayer import colour_means
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import quantise
from torchweather.scenes.scene import Scene, SceneLabel

__all__ = ["DRY", "INDOORS", "RawFrame", "linear_camera", "raw_frame"]

INDOORS = ("fog-tunnel", "thi-hall", "cerema-tunnel")
"""Scenes where no sky is in view."""
DRY = ("fog-tunnel",)
"""Scenes in which it neither rains nor snows."""


@dataclass(frozen=True, eq=False)
class RawFrame:
    """A raw frame with its depth.

    Args:
        bayer: ``(1, H, W)`` uint16, in the levels of the camera, with its shot noise.
        depth_m: ``(1, H, W)``, infinite for the sky.
        camera: linear, of the size of the frame.
        airlight: linear signal of red, green and blue of what stands for the sky; ``None``: the sky is in the frame.
    """

    bayer: Tensor
    depth_m: Tensor
    camera: Camera
    airlight: tuple[float, float, float] | None


def linear_camera(camera: Camera) -> Camera:
    """The camera without a companding curve: scenes give linear light."""
    return Camera.from_dict({**camera.to_dict(), "response_knots": None})


def raw_frame(scene: Scene, camera: Camera, *, seed: int = 0) -> RawFrame:
    """Raw frame of an embedded scene, as a camera delivers it.

    Args:
        scene: one of ``torchweather.scenes.SCENES``.
        camera: with the size of the frame; its companding curve is left out.
        seed: of the shot noise.

    Returns:
        The frame. Of a scene in ``INDOORS`` the airlight is the mean signal of its lit walls and roof.

    Example:
        >>> from torchweather.scenes import test_track
        >>> frame = raw_frame(test_track(), Camera.preset("lucid-triton").resized(32, 24))
        >>> frame.bayer.shape, frame.bayer.dtype, frame.airlight
        (torch.Size([1, 24, 32]), torch.uint16, None)
    """
    plain = linear_camera(camera)
    view = scene.view(plain, shot_noise_seed=seed)
    airlight = None
    if scene.name in INDOORS:
        bright = (view.label == SceneLabel.ROOF) | (view.label == SceneLabel.WALL)
        red, green, blue = (float(v) for v in colour_means(view.bayer, plain.bayer_pattern, mask=bright))
        airlight = (red, green, blue)
    raw = quantise(view.bayer, torch.int32, plain.black_level, plain.saturation_level).to(torch.uint16)
    return RawFrame(raw, view.depth_m, plain, airlight)
