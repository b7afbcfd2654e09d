"""Camera transform as a function of tensors: image, depth, shares, intrinsics, intensities, noise in; image out."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from torchweather.camera.bayer import cfa_colour_index
from torchweather.camera.fog import ExtinctionAndAirlight
from torchweather.camera.particles.veil import ParticleVeil
from torchweather.camera.rays import rays_of
from torchweather.camera.rgb import AsBayer
from torchweather.camera.rgb_planes import encoded_planes, linear_planes
from torchweather.camera.state import CameraState
from torchweather.camera.transform import BayerWeather
from torchweather.core.errors import InputValueError
from torchweather.core.random import draw_variates, sizes_of
from torchweather.export.metadata import described, sections_of
from torchweather.export.traceable import GraphForm, GraphSizes, Traceable, refuse_what_follows_rain, variates_of

__all__ = ["BAYER_FORM", "IMAGE_OUTPUTS", "RGB_FORM", "traceable_camera"]

IMAGE_OUTPUTS = {"bayer": "signal", "rgb": "weathered"}
"""Image input of a camera's graph to its output."""
INTRINSICS = ("fx", "fy", "cx", "cy")
SHARES = ("sky", "near_mask")
SECTION = "4"  # of docs/PHYSICS.md


def traceable_camera(transform: BayerWeather | AsBayer, height: int, width: int, *, masks: bool = False) -> Traceable:
    """Parts of a camera transform that the exporter needs.

    Args:
        transform: of raw frames, or of RGB images as colour planes.
        height, width: of the traced image.
        masks: whether shares of sky and of the own vehicle are inputs.
    """
    image = "bayer"
    if isinstance(transform, AsBayer):
        if transform.through_mosaic:
            raise InputValueError(
                "AsBayer.through_mosaic: a graph takes colour planes or a raw mosaic, and does not sample or demosaic; "
                "got True. Take its transform, whose graph takes the mosaic, or leave through_mosaic out."
            )
        image, transform = "rgb", transform.transform
    refuse_what_follows_rain(transform)
    device = next(iter(transform.buffers()), torch.empty(0)).device
    graph = _CameraGraph(transform, image, masks=masks).to(device)
    arguments, shapes, names = _example(graph, height, width, device)
    outputs, sections = [IMAGE_OUTPUTS[image]], (SECTION, *sections_of(transform.weather))
    text = described(transform, image=image)
    levels = _levels(transform)
    return Traceable(graph, arguments, shapes, names, outputs, graph.variates, text, sections, levels=levels)


def _trace(transform: BayerWeather | AsBayer, sizes: GraphSizes) -> Traceable:
    return traceable_camera(transform, sizes.height, sizes.width, masks=sizes.masks)


BAYER_FORM = GraphForm(_trace, takes_masks=True)
RGB_FORM = GraphForm(_trace, whole_cells=False, takes_masks=True)


class _CameraGraph(nn.Module):
    """A camera transform as a function of tensors only.

    Args:
        transform: of the camera.
        image: ``bayer`` for raw frames, ``rgb`` for RGB images as colour planes.
        masks: whether ``forward`` takes the shares of sky and own vehicle.
    """

    def __init__(self, transform: BayerWeather, image: str, *, masks: bool) -> None:
        super().__init__()
        self.image = image
        self.shares: tuple[str, ...] = SHARES if masks else ()
        self.chain = transform.chain
        self.camera, self.layer_top_m = transform.camera, transform.layer_top_m
        cfa = torch.tensor(cfa_colour_index(self.camera.bayer_pattern)) if self.image == "bayer" else None
        self.register_buffer("cfa_index", cfa)
        self.cfa_index: Tensor | None
        self.variates = variates_of(self.chain)
        self.intensities = _intensities(transform)

    def forward(
        self,
        image: Tensor,
        depth: Tensor,
        shares: list[Tensor],
        intrinsics: list[Tensor],
        intensities: list[Tensor],
        noise: list[Tensor],
    ) -> Tensor:
        height, width = image.shape[-2:]
        fx, fy, cx, cy = intrinsics
        x = (torch.arange(width, device=image.device, dtype=image.dtype) - cx) / fx
        y = (torch.arange(height, device=image.device, dtype=image.dtype) - cy) / fy
        rays = rays_of(self.camera, *self.camera.undistort(x, y[None, None, :, None]), self.layer_top_m)
        named_shares = dict(zip(self.shares, shares, strict=True))
        state = CameraState.of(
            signal=linear_planes(image) if self.cfa_index is None else image,
            depth_m=depth,
            ray_per_depth=rays.per_depth,
            cfa_index=self.cfa_index,
            intrinsics=torch.stack([fx, fy, cx, cy])[None],
            camera=self.camera,
            ray_in_layer_m=rays.in_layer_m,
            sine_elevation=rays.sine_elevation,
            sky=named_shares.get("sky"),
            near_mask=named_shares.get("near_mask"),
        )
        named_noise = dict(zip(self.variates, noise, strict=True))
        named_intensities = dict(zip(self.intensities.values(), intensities, strict=True))
        after: CameraState = torch.func.functional_call(self.chain, named_intensities, (state, named_noise))
        if self.cfa_index is None:
            return encoded_planes(after.image.signal, state.image.signal, image)
        return after.image.signal


def _intensities(transform: BayerWeather) -> dict[str, str]:
    """Graph input name to buffer name of every intensity."""
    found: dict[str, str] = {}
    for name, stage in transform.chain.stages.items():
        if isinstance(stage, ExtinctionAndAirlight):
            found["mor_m"] = f"_stages.{name}.mor_m"
        if isinstance(stage, ParticleVeil):
            alone = len(stage.parts) == 1
            for number, part in enumerate(stage.parts):
                key = "rate_mm_per_h" if alone else f"{part.weather.kind}_rate_mm_per_h"
                found[key] = f"_stages.{name}.populations.{number}.rate_mm_per_h"
    return found


def _levels(transform: BayerWeather) -> dict[str, Any]:
    """Noise input to the rate that its points belong to, and how many of them each rate shows."""
    inputs = {buffer: name for name, buffer in _intensities(transform).items()}
    found = {}
    for name, stage in transform.chain.stages.items():
        if not isinstance(stage, ParticleVeil):
            continue
        for variate, (part, limits) in stage.level_limits(transform.chain.written_beside(name)).items():
            rate = inputs[f"_stages.{name}.populations.{stage.parts.index(part)}.rate_mm_per_h"]
            low, step = part.tables.log_rate_low, part.tables.log_rate_step
            limit = [math.ceil(value * 1e4) / 1e4 for value in limits.tolist()]
            found[f"{name}.{variate}"] = {"rate": rate, "log_rate_low": low, "log_rate_step": step, "log_limit": limit}
    return found


def _example(
    graph: _CameraGraph, height: int, width: int, device: torch.device
) -> tuple[tuple[Any, ...], tuple[Any, ...], list[str]]:
    """Arguments to trace with, their dynamic dimensions, and the names of the inputs."""
    planes = 1 if graph.image == "bayer" else 3
    sizes = sizes_of(height, width, planes)
    dims: dict[str, Any]
    if graph.image == "bayer":
        half_h, half_w = torch.export.Dim("half_height", min=1), torch.export.Dim("half_width", min=1)
        dims = {"H": 2 * half_h, "W": 2 * half_w}
    else:
        # Windows of the airlight's estimate reach over 3 pixels.
        dims = {"H": torch.export.Dim("height", min=3), "W": torch.export.Dim("width", min=3)}
    frame = {2: dims["H"], 3: dims["W"]}
    noise, noise_shapes = [], []
    for number, (key, variate) in enumerate(graph.variates.items()):
        stage, _, _ = key.partition(".")
        array = draw_variates([0], stage, [variate], sizes)[key]
        noise.append(torch.from_numpy(array).to(device))
        if variate.law == "points":
            noise_shapes.append({1: torch.export.Dim(f"points_{number}", min=2)})
        else:
            noise_shapes.append({i + 1: dims[d] for i, d in enumerate(variate.shape) if d in dims})
    intensities = [torch.full((1,), 50.0, device=device) for _ in graph.intensities]
    camera = graph.camera
    intrinsics = [torch.tensor(float(value), device=device) for value in camera.intrinsics]
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(1, planes, height, width, generator=generator).to(device)
    depth = 5.0 + 20.0 * torch.rand(1, 1, height, width, generator=generator).to(device)
    shares = [torch.rand(1, 1, height, width, generator=generator).to(device) for _ in graph.shares]
    arguments = (image, depth, shares, intrinsics, intensities, noise)
    shapes: tuple[Any, ...] = (
        frame,
        frame,
        [frame for _ in shares],
        [{} for _ in intrinsics],
        [{} for _ in intensities],
        noise_shapes,
    )
    return arguments, shapes, [graph.image, "depth", *graph.shares, *INTRINSICS, *graph.intensities, *graph.variates]
