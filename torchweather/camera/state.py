"""The state of a camera frame on its way through a chain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.density_field import PatchField
from torchweather.camera.night.lamp_light import LampLight
from torchweather.camera.sensor import Camera
from torchweather.pipeline.graph_operations import cells_apart, cells_together
from torchweather.pipeline.state import PartedState

__all__ = ["CameraAir", "CameraImage", "CameraReceiver", "CameraScene", "CameraState"]


@dataclass(frozen=True)
class CameraScene:
    """Geometry of what the pixels show.

    Args:
        depth_m: ``(B, 1, H, W)`` metres along the optical axis; infinity is sky.
        ray_per_depth: ``(1 or B, 1, H, W)`` length of a pixel's ray per metre of depth, 1 / cos(theta).
        intrinsics: ``(1 or B, 4)`` fx, fy, cx, cy in pixels.
        normal: ``(1 or B, 3, H, W)`` unit normals of the surfaces in the vehicle's frame, 0 where there is none;
            ``None`` where not known.
        ray_in_layer_m: ``(1 or B, 1, H, W)`` length of each pixel's ray up to the top of the fog, metres
            (``PHYSICS.md`` 10.11); ``None``: fog has no top.
        sky: ``(1 or B, 1, H, W)`` share of each pixel that shows the sky; ``None``: where the depth is infinite.
        near_mask: ``(1 or B, 1, H, W)`` share of each pixel that shows the own vehicle, with no weather in front of it;
            ``None``: nowhere.
        ground: ``(1 or B, 1, H, W)`` probability that a pixel shows the ground, where the depth is guessed; ``None``:
            the ground is what is level and low.
        sine_elevation: ``(1 or B, 1, H, W)`` sine of each ray's elevation above the horizon; ``None`` where not known.
        damp: ``(B, 1, H, W)`` share of each pixel's surface that water can darken; ``None``: all of it.
        pool: ``(B, 1, H, W)`` share of each pixel's surface that lies under smooth water; ``None``: all of it.
    """

    depth_m: Tensor
    ray_per_depth: Tensor
    intrinsics: Tensor
    normal: Tensor | None = None
    ray_in_layer_m: Tensor | None = None
    sky: Tensor | None = None
    near_mask: Tensor | None = None
    ground: Tensor | None = None
    sine_elevation: Tensor | None = None
    damp: Tensor | None = None
    pool: Tensor | None = None


@dataclass(frozen=True)
class CameraAir:
    """Fog, particles and light of the sky.

    Args:
        airlight: ``(B, 3)`` linear signal of an infinitely deep fog, per colour; ``None`` until a stage sets it.
        fog_extinction_per_m: ``(B, 3)`` extinction of a continuous medium along the ray; ``None`` is clear air.
        airlight_scale: ``(B, 3)`` light of the sky over the modelled one, per colour; ``None`` is 1.
        extinction_scale: ``(B, 3)`` extinction of fog over the modelled one, per colour; ``None`` is 1.
        fog_density: ``(B, 1, H, W)`` density of fog, mean along each pixel's ray, over that of the weather; ``None``
            is 1.
        particle_count: ``(B,)`` falling particles in the air over those of the weather; ``None`` is 1.
        particle_reach_m: ``(B,)`` depth from which on the air holds none; ``None`` is infinity.
        particle_contrast: ``(B,)`` what particles change in the picture over the modelled; ``None`` is 1.
        path_tangent: ``(B,)`` sideways over downward speed of falling particles, to the right; ``None`` is 0.
        patches: where about the vehicle the air is dense; ``None`` is everywhere alike.
        lamp_excess: ``(B, C, H, W)`` light of lamps beyond what the saturated frame shows of them; ``None`` by day.
        lamp_light: light of lamps on fog and particles; ``None`` by day.
        skylight: ``(B, 3)`` signal of the sky that lights the scene, per colour; ``None`` where not known.
    """

    airlight: Tensor | None = None
    fog_extinction_per_m: Tensor | None = None
    airlight_scale: Tensor | None = None
    extinction_scale: Tensor | None = None
    fog_density: Tensor | None = None
    particle_count: Tensor | None = None
    particle_reach_m: Tensor | None = None
    particle_contrast: Tensor | None = None
    path_tangent: Tensor | None = None
    patches: PatchField | None = None
    lamp_excess: Tensor | None = None
    lamp_light: LampLight | None = None
    skylight: Tensor | None = None


@dataclass(frozen=True)
class CameraImage:
    """The light on the pixels, and what the weather did to it.

    Args:
        signal: ``(B, C, H, W)`` linear in light, black 0, saturation 1.
        transmission: ``(B, 1, H, W)`` share of the scene's light that the continuous medium lets through;
            ``None`` where it is 1 or was not asked for.
        particle_mask: ``(B, 1, H, W)`` share of the exposure in which particles cover the pixel; ``None`` likewise.
    """

    signal: Tensor
    transmission: Tensor | None = None
    particle_mask: Tensor | None = None


@dataclass(frozen=True)
class CameraReceiver:
    """Camera, colours of the pixels and readout.

    Args:
        cfa_index: ``(2, 2)`` colour of each cell of a mosaic: 0 red, 1 green or clear, 2 blue; ``None`` for colour
            planes (red, green, blue).
        camera: that took the frame; ``None`` where not known.
        row_time_s: ``(B,)`` from the exposure of a row to that of the row below; ``None`` is 0.
        metered_signal: ``(B,)`` statistic of the frame before the weather that a control of the exposure keeps;
            ``None`` where none was taken.
        keep_truth: compute ``transmission`` and ``particle_mask`` although the signal needs neither.
    """

    cfa_index: Tensor | None
    camera: Camera | None = None
    row_time_s: Tensor | None = None
    metered_signal: Tensor | None = None
    keep_truth: bool = False


@dataclass(frozen=True)
class CameraState(PartedState):
    """A camera frame on its way through the chain; B is the flattened batch.

    A frame is a mosaic, C = 1, or a picture of three colour planes, C = 3. Stages treat both alike: a value per colour
    is spread over the pixels by `per_pixel` and broadcast against `by_cells`.
    """

    parts: ClassVar[dict[str, type[Any]]] = {
        "scene": CameraScene,
        "air": CameraAir,
        "image": CameraImage,
        "receiver": CameraReceiver,
    }

    scene: CameraScene
    air: CameraAir
    image: CameraImage
    receiver: CameraReceiver

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        return {"C": self.image.signal.shape[1], "H": self.image.signal.shape[-2], "W": self.image.signal.shape[-1]}

    @property
    def batch(self) -> int:
        """Number of samples."""
        return self.image.signal.shape[0]

    @property
    def ray_length_m(self) -> Tensor:
        """``(B, 1, H, W)`` distance along each pixel's ray, metres."""
        return self.scene.depth_m * self.scene.ray_per_depth

    @property
    def one_plane(self) -> Tensor:
        """``(B, 1, H, W)`` the signal's first plane: the shape, dtype and device of what all colours share."""
        return self.image.signal[:, :1]

    def fog_path_m(self, depth_m: Tensor, rows: slice = slice(None)) -> Tensor:
        """Length of each pixel's ray inside the fog, metres: to its surface, or to the top of the layer.

        Args:
            depth_m: ``(B, 1, rows, W)`` depth in these rows.
            rows: of the frame.
        """
        length_m = depth_m * self.scene.ray_per_depth[..., rows, :]
        if self.scene.ray_in_layer_m is None:
            return length_m
        return torch.minimum(length_m, self.scene.ray_in_layer_m[..., rows, :])

    def per_pixel(self, per_colour: Tensor) -> Tensor:
        """Spread a value per colour ``(B, 3)`` over the pixels, to be broadcast against ``by_cells``.

        Of a mosaic it is one row pair, ``(B, 1, 1, 2, W)``; of colour planes ``(B, 3, 1, 1, 1)``.
        """
        if self.receiver.cfa_index is None:
            return per_colour[:, :, None, None, None]
        cell = per_colour[:, self.receiver.cfa_index]  # (B, 2, 2)
        row_pair = cell.repeat(1, 1, self.image.signal.shape[-1] // 2)  # (B, 2, W)
        return row_pair[:, None, None]

    def by_cells(self, image: Tensor) -> Tensor:
        """View ``(B, C, H, W)`` with the rows of the CFA's cells apart; ``flatten(2, 3)`` takes it back.

        Of a mosaic it is ``(B, C, H/2, 2, W)``; of colour planes ``(B, C, 1, H, W)``.
        """
        b, c, h, w = image.shape
        return image[:, :, None] if self.receiver.cfa_index is None else image.reshape(b, c, h // 2, 2, w)

    def per_place(self, per_colour: Tensor) -> Tensor:
        """``per_pixel`` to be broadcast against ``by_places``: ``(B, 4 or 3, 1, 1)``."""
        cfa = self.receiver.cfa_index
        each = per_colour if cfa is None else per_colour.index_select(1, cfa.flatten())
        return each[:, :, None, None]

    def by_places(self, image: Tensor) -> Tensor:
        """One plane for each place in the CFA's cells, ``(B, 4, H/2, W/2)``; colour planes as they are."""
        return image if self.receiver.cfa_index is None else cells_apart(image)

    def from_places(self, planes: Tensor) -> Tensor:
        """The image of which ``by_places`` gives some planes."""
        return planes if self.receiver.cfa_index is None else cells_together(planes)


for _part in (LampLight, CameraScene, CameraAir, CameraImage, CameraReceiver, CameraState):
    torch.export.register_dataclass(_part, serialized_type_name=f"torchweather.{_part.__name__}")
