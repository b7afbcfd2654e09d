"""The frames of a page: the embedded scenes or a user's own, raw or RGB, and how each is rendered and shown."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.camera.bayer import cfa_index, mosaic
from torchweather.camera.levels import raw_to_linear
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import normalise, quantise, srgb_decode
from torchweather.camera.transform import BayerWeather
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.image.depth import FlatGround, as_depth_source
from torchweather.io import read_image, write_image
from torchweather.io.depth_maps import map_source
from torchweather.report.machine import library_warnings
from torchweather.report.pictures import Look, look_of
from torchweather.scenes import fog_tunnel, test_track
from torchweather.scenes.raw_frame import raw_frame

__all__ = ["Frame", "Rendered", "embedded_frames", "user_frame"]


@dataclass(frozen=True)
class Rendered:
    """A frame in a weather.

    Args:
        data: in the format of the clear frame.
        linear: mosaic ``(1, H, W)``, black 0, saturation 1.
        transmission, particle_mask: ``(1, H, W)``.
        transform: that made it.
        times_s: seconds for the set-up (transform built), the draw and the rendering.
        warnings: what the library warned of.
    """

    data: Tensor
    linear: Tensor
    transmission: Tensor
    particle_mask: Tensor
    transform: BayerWeather
    times_s: dict[str, float]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Frame:
    """A clear frame with its depth and camera.

    Args:
        name: of its files.
        title: on the page.
        data: mosaic ``(1, H, W)`` or RGB ``(3, H, W)``.
        depth_m: ``(1, H, W)``.
        camera: of the size of the frame.
        airlight: linear signal of the sky; ``None`` takes it from the frame.
        indoors: it neither rains nor snows there.
        notes: what a reader must know of the input.
    """

    name: str
    title: str
    data: Tensor
    depth_m: Tensor
    camera: Camera
    airlight: tuple[float, float, float] | None = None
    indoors: bool = False
    notes: tuple[str, ...] = ()
    linear: Tensor = field(init=False)
    look: Look = field(init=False)

    def __post_init__(self) -> None:
        linear = self._linear(self.data)
        object.__setattr__(self, "linear", linear)
        look = Look((1.0, 1.0, 1.0), 1.0) if self.is_rgb else look_of(linear, self.depth_m, self.camera)
        object.__setattr__(self, "look", look)

    @property
    def is_rgb(self) -> bool:
        """True for a colour image, False for a mosaic."""
        return self.data.shape[-3] == 3

    def _linear(self, data: Tensor) -> Tensor:
        if self.is_rgb:
            return mosaic(srgb_decode(normalise(data)), self.camera.bayer_pattern)
        return raw_to_linear(data, self.camera, "demo")

    def picture(self, data: Tensor) -> Tensor:
        """Display picture ``(3, H, W)`` in 0..1, developed as the clear frame is."""
        return normalise(data) if self.is_rgb else self.look.develop(self._linear(data), self.camera.bayer_pattern)

    def colours(self, linear: Tensor) -> list[tuple[str, Tensor]]:
        """Signal of the pixels of each colour of the filter array."""
        index = cfa_index(linear.shape[-2], linear.shape[-1], self.camera.bayer_pattern)
        return [(name, linear[0][index == number]) for number, name in enumerate(self.camera.bands)]

    def render(self, weather: Weather, seed: int) -> Rendered:
        """The frame in a weather, drawn with ``seed``."""
        started = time.perf_counter()
        with library_warnings() as said:
            transform = BayerWeather(weather, self.camera, airlight=self.airlight)
            taker = AsBayer(transform) if self.is_rgb else transform
            built = time.perf_counter()
            noise = taker.draw(self.data, seed=seed)
            drawn = time.perf_counter()
            with torch.no_grad():
                result = taker.run(self.data, self.depth_m, noise)
            done = time.perf_counter()
        data = result.rgb if self.is_rgb else result.bayer  # type: ignore[union-attr]
        return Rendered(
            data=data,
            linear=self._linear(data),
            transmission=result.transmission,
            particle_mask=result.particle_mask,
            transform=transform,
            times_s={"set_up_s": built - started, "draw_s": drawn - built, "render_s": done - drawn},
            warnings=tuple(said),
        )

    def write(self, path: Path, data: Tensor) -> None:
        """Write a frame as PNG: a mosaic of a float frame in the 16-bit numbers of the camera."""
        if data.is_floating_point() and not self.is_rgb:
            data = quantise(data, torch.int32, 0.0, 65535.0).to(torch.uint16)
        elif self.is_rgb and data.dtype != torch.uint8:
            data = quantise(normalise(data), torch.uint8)
        write_image(path, data)


def embedded_frames(camera: Camera, seed: int) -> list[Frame]:
    """The test track and the fog tunnel as raw frames with the camera's bits and its noise."""
    track = raw_frame(test_track(), camera, seed=seed)
    # The tunnel is a side note: half the pixels in each direction show it as well, in a quarter of the time.
    half = camera.resized(max(2, camera.width // 4 * 2), max(2, camera.height // 4 * 2))
    tunnel = raw_frame(fog_tunnel(), half, seed=seed)
    return [
        Frame(
            "test-track",
            "Test track",
            track.bayer,
            track.depth_m,
            track.camera,
            notes=("The scene is computed, so its depth is exact: cars at 28 m and 56 m, grey boards at 21 m.",),
        ),
        Frame(
            "fog-tunnel",
            "Fog tunnel",
            tunnel.bayer,
            tunnel.depth_m,
            tunnel.camera,
            airlight=tunnel.airlight,
            indoors=True,
            notes=("No sky is in view: the airlight is the mean signal of the lit walls and roof.",),
        ),
    ]


def user_frame(path: Path, name: str, depth: object, camera: Camera | None) -> Frame:
    """A user's frame with its depth.

    Args:
        path: image file, raw mosaic or RGB.
        name: of its files in the output.
        depth: a depth file, or what ``torchweather.image.as_depth_source`` takes; ``None`` is flat ground.
        camera: of the size of the image; ``None`` takes the view angles of the default preset.
    """
    data, info = read_image(path)
    if data.ndim != 3:
        raise TorchweatherError(f"{path}: the demo takes single frames (1 or 3, H, W); got {tuple(data.shape)}.")
    height, width = data.shape[-2:]
    notes = []
    if camera is None:
        camera = Camera.preset("lucid-triton").fitted_to(width, height)
        notes.append("No camera was given: the view of lucid-triton is assumed, so sizes may be off.")
    if info.kind == "rgb":
        notes.append("The frame is RGB: it is taken for plain sRGB and weathered in linear light.")
    if depth is None:
        source: Any = FlatGround()
        notes.append("No depth was given: flat ground below a sky is assumed, so objects stand too far away.")
    elif isinstance(depth, (str, Path)):
        source = map_source(Path(depth))
    else:
        source = as_depth_source(depth)
    depth_m = source(camera, height, width, image=data).reshape(1, height, width)
    return Frame(name, path.name, data, depth_m, camera, notes=tuple(notes))


def user_frames(paths: Sequence[Path], depth: object, camera: Camera | None) -> list[Frame]:
    """``user_frame`` for each path; a list of depths is taken one by one."""
    depths = list(depth) if isinstance(depth, (list, tuple)) else [depth] * len(paths)
    if len(depths) != len(paths):
        raise InputValueError(
            f"write_demo: expected one depth, or one for each of the {len(paths)} images; got {len(depths)}."
        )
    return [
        user_frame(Path(path), f"frame-{number}", one, camera)
        for number, (path, one) in enumerate(zip(paths, depths, strict=True))
    ]
