"""DepthNetwork: depth of a photograph from any depth network in an ONNX file."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.depth.completion_scene import CompletedSource
from torchweather.camera.depth.ground import FlatGround
from torchweather.camera.depth.horizon import Horizon, find_horizon, horizon_of_camera
from torchweather.camera.depth.near_mask import find_near_mask
from torchweather.camera.depth.network_graph import NetworkGraph, open_graph
from torchweather.camera.depth.network_scale import check_metric, fit_to_ground, fit_to_points, points_in_picture
from torchweather.camera.depth.scene_depth import COMPLETED, GUESSED, SceneDepth
from torchweather.camera.depth.source import SceneSource
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError, check_one_of, check_positive

__all__ = ["IMAGENET_MEAN", "IMAGENET_STD", "DepthNetwork"]

# Of RGB in 0..1 over ImageNet's training pictures, the usual normalisation of encoders that were trained on it.
IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
OUTPUTS = ("depth", "inverse_depth", "disparity")
SCALES = ("metric", "ground")
# Above this share of sky a pixel shows nothing else (as in CompletedDepth).
_SKY_ALONE = 0.99
# Depth of the own vehicle: nearer than a metre from behind the windscreen (PHYSICS 10.12).
_OWN_VEHICLE_M = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class DepthNetwork(SceneSource):
    """Depth by a network in an ONNX file, run with onnxruntime.

    The network takes one RGB picture and gives one map: metric depth, inverse depth, or disparity. A relative map gets
    its scale, and an inverse one its shift too, from flat ground below the camera or from measured points. The sky
    is that of `sky_mask`: most networks give it some large depth.

    Args:
        path: of the ONNX file: one float input ``(1, 3, H, W)`` or ``(1, H, W, 3)``, one map out. Compared with the
            graph here, before any picture.
        output: of the network: ``depth``, ``inverse_depth``, or ``disparity`` in pixels of its own input.
        scale: ``metric``: the output is in metres (1/m, or pixels with ``baseline_m``). ``ground``: unknown, from the
            ground. A `CompletedDepth` or `CompletedDepthMap`: unknown, from its points.
        multiple_px: where the graph leaves its size open, height and width are rounded to multiples of this: 14 for
            ViT-S/14 and its like, 32 for convolutional encoders.
        shorter_side_px: where the graph leaves its size open, the picture is scaled to it. Default: as it is.
        mean: of RGB in 0..1, taken off. Default: ImageNet's.
        std: of RGB in 0..1, divided by. Default: ImageNet's.
        baseline_m: of the stereo pair, metres, for a metric ``disparity``.
        farthest_m: greatest depth of a surface, metres.
        layout: ``NCHW`` or ``NHWC``. Default: where the graph has its three channels.
        output_name: of the map, where the graph gives several.
        providers: of onnxruntime, in order.
        threads: of onnxruntime; 0 takes all cores.
        sky: ``(1, H, W)`` share of sky of each pixel, or a function that makes it from the picture. ``None``:
            `sky_mask`.
        near_mask: ``auto`` looks for the own bonnet; ``(1, H, W)`` gives it; ``None``: there is none in view.
        horizon: ``auto`` looks for the vanishing point in the picture; ``camera`` keeps the camera's own pitch.

    Note:
        The confidence is ``completed`` where measured points scale the map, else ``guessed``. With ``ground``, depth is
        wrong by as much as the camera's height, and half a degree of pitch moves ground at 30 m by 16 %.

    Example:
        >>> network = DepthNetwork("midas.onnx", output="inverse_depth", scale="ground", multiple_px=32)
        Traceback (most recent call last):
        torchweather.core.errors.TorchweatherError: midas.onnx: no such file; expected a depth network as an ONNX graph.
    """

    confidence: ClassVar[str] = GUESSED
    one_picture: ClassVar[bool] = True

    path: str | os.PathLike[str]
    output: str = "depth"
    scale: str | CompletedSource = "metric"
    multiple_px: int = 14
    shorter_side_px: int | None = None
    mean: Sequence[float] = IMAGENET_MEAN
    std: Sequence[float] = IMAGENET_STD
    baseline_m: float | None = None
    farthest_m: float = 200.0
    layout: str | None = None
    output_name: str | None = None
    providers: Sequence[str] = ("CPUExecutionProvider",)
    threads: int = 0
    sky: Tensor | Callable[[Tensor], Tensor] | None = None
    near_mask: Tensor | str | None = "auto"
    horizon: str = "auto"

    def __post_init__(self) -> None:
        check_one_of("output", self.output, OUTPUTS, owner=self)
        check_one_of("horizon", self.horizon, ("auto", "camera"), owner=self)
        if isinstance(self.near_mask, str):
            check_one_of("near_mask", self.near_mask, ("auto",), owner=self)
        if self.layout is not None:
            check_one_of("layout", self.layout, ("NCHW", "NHWC"), owner=self)
        check_positive("multiple_px", self.multiple_px, unit="px", owner=self)
        check_positive("farthest_m", self.farthest_m, unit="m", owner=self)
        if self.shorter_side_px is not None:
            check_positive("shorter_side_px", self.shorter_side_px, unit="px", owner=self)
        for name in ("mean", "std"):
            values = tuple(float(value) for value in getattr(self, name))
            if len(values) != 3 or not all(math.isfinite(value) for value in values):
                raise InputValueError(f"DepthNetwork: {name} must be three numbers, of R, G, B in 0..1; got {values}.")
            object.__setattr__(self, name, values)
        if not all(value > 0 for value in self.std):
            raise InputValueError(
                f"DepthNetwork: std must be above 0; got {self.std}. Leave mean and std at 0 and 1 for none."
            )
        if isinstance(self.scale, CompletedSource):
            object.__setattr__(self, "confidence", COMPLETED)
        elif not isinstance(self.scale, str) or self.scale not in SCALES:
            raise InputValueError(
                f"DepthNetwork: scale must be {' or '.join(map(repr, SCALES))}, or the points as "
                "CompletedDepth(points_xyz, T_camera_from_lidar) or CompletedDepthMap(depth_m); got "
                f"{self.scale!r}."
            )
        metric_disparity = self.output == "disparity" and self.scale == "metric"
        if metric_disparity and self.baseline_m is None:
            raise InputValueError(
                "DepthNetwork: a metric disparity needs baseline_m, metres between the two lenses (--baseline-m); or "
                "give scale='ground'."
            )
        if self.baseline_m is not None:
            check_positive("baseline_m", self.baseline_m, unit="m", owner=self)
            if not metric_disparity:
                raise InputValueError("DepthNetwork: baseline_m belongs to output='disparity' with scale='metric'.")
        object.__setattr__(self, "providers", tuple(self.providers))
        self._graph()

    def _graph(self) -> NetworkGraph:
        return open_graph(os.fspath(self.path), tuple(self.providers), self.threads, self.layout, self.output_name)

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
            camera: intrinsics and lens distortion; mounting and height for ``scale="ground"``.
            height: rows.
            width: columns.
            device: of the result. Default: the image's.
            dtype: of the result.
            image: sRGB ``(3, H, W)``, uint8 or float 0..1.
        """
        if image is None or tuple(image.shape) != (3, height, width):
            raise InputValueError(
                f"DepthNetwork: expected one colour picture (3, {height}, {width}) as image; got "
                f"{'none' if image is None else tuple(image.shape)}. Demosaic a raw frame first; call it for each "
                "picture of a batch (scene_of does)."
            )
        device = image.device if device is None else device
        rgb = image.detach().cpu()
        rgb = rgb.to(torch.float32) / (1 if rgb.is_floating_point() else 255)
        horizon = find_horizon(rgb, camera) if self.horizon == "auto" else horizon_of_camera(camera)
        near = self._share("near_mask", rgb, horizon)
        sky = self._share("sky", rgb, horizon) * (1.0 - near)
        usable = (sky < 0.01) & (near < 0.01)
        inverse, note = self._scaled(self._inverse(rgb, camera), usable, camera, horizon)
        depth_m = 1.0 / inverse.clamp(min=1.0 / self.farthest_m)
        notes = [note]
        if bool((near > 0).any()):
            notes.append(f"the own vehicle covers {100 * float(near.mean()):.1f} % of the picture")
        depth_m = torch.where(near > 0.5, depth_m.clamp(max=_OWN_VEHICLE_M), depth_m)
        depth_m = torch.where(sky > _SKY_ALONE, torch.inf, depth_m)
        return SceneDepth(
            depth_m[None],
            self.confidence,
            sky=sky[None],
            near_mask=near[None],
            horizon_row=horizon.row if horizon.confidence > 0 else None,
            notes=tuple(notes),
        ).to(device, dtype)

    def _inverse(self, rgb: Tensor, camera: Camera) -> Tensor:
        """The network's answer as an inverse depth ``(H, W)`` in its own unit, float64."""
        graph = self._graph()
        height, width = rgb.shape[-2:]
        size = self._input_size(graph, height, width)
        scaled = torch.nn.functional.interpolate(rgb[None], size, mode="bicubic", align_corners=False, antialias=True)[
            0
        ].clamp(0.0, 1.0)
        mean, std = (torch.tensor(values)[:, None, None] for values in (self.mean, self.std))
        found = torch.from_numpy(graph.run(((scaled - mean) / std).numpy())).to(torch.float64)
        if self.output == "depth":
            if not bool((found > 0).any()):
                raise InputValueError(
                    f"DepthNetwork: {self.path} gives no depth above 0. Is its output an inverse depth?"
                )
            # A network without a limit may give 0 or less: the nearest depth that it gives above 0 stands for those.
            found = 1.0 / found.clamp(min=float(found[found > 0].min()))
        elif self.output == "disparity" and self.baseline_m is not None:
            # Disparity in pixels of the network's input, at the frame's focal length there.
            found = found / (camera.fx * size[1] / width * self.baseline_m)
        # Inverse depth is linear across a plane: interpolated so, a plane stays a plane.
        full = torch.nn.functional.interpolate(found[None, None], (height, width), mode="bilinear", align_corners=False)
        return full[0, 0]

    def _input_size(self, graph: NetworkGraph, height: int, width: int) -> tuple[int, int]:
        factor = 1.0 if self.shorter_side_px is None else self.shorter_side_px / min(height, width)
        rounded = [max(1, round(side * factor / self.multiple_px)) * self.multiple_px for side in (height, width)]
        first, second = (fixed or own for fixed, own in zip(graph.size, rounded, strict=True))
        return int(first), int(second)

    def _scaled(self, inverse: Tensor, usable: Tensor, camera: Camera, horizon: Horizon) -> tuple[Tensor, str]:
        """Inverse depth, 1/m, and what was done, in words."""
        name = os.path.basename(os.fspath(self.path))
        with_shift = self.output != "depth"
        height, width = inverse.shape
        if isinstance(self.scale, CompletedSource):
            x, depth_m = points_in_picture(self.scale, inverse.numpy(), usable.numpy(), camera)
            line = fit_to_points(x, depth_m, with_shift=with_shift)
            return line.scale * inverse + line.shift, (
                f"depth is that of the network {name}, scaled by {len(x)} measured points; {line.agreeing:.0%} of them "
                "agree within 10 %"
            )
        pitched = dataclasses.replace(camera, pitch_rad=horizon.pitch_rad)
        ground_m = FlatGround()(pitched, height, width, dtype=torch.float64)[0]
        if self.scale == "ground":
            line = fit_to_ground(inverse.numpy(), ground_m.numpy(), usable.numpy(), with_shift=with_shift)
            return line.scale * inverse + line.shift, (
                f"depth is guessed: the network {name}, scaled by flat ground {camera.height_m:.3g} m below the "
                f"camera; {line.agreeing:.0%} of the pixels where it would lie agree within 10 %"
            )
        check_metric(inverse.numpy(), ground_m.numpy(), usable.numpy(), os.fspath(self.path))
        note = f"depth is guessed: the network {name}, whose output is taken for metres"
        try:
            line = fit_to_ground(inverse.numpy(), ground_m.numpy(), usable.numpy(), with_shift=False)
        except ValueError:  # no ground in view
            return inverse, note
        return inverse, (
            f"{note}; flat ground {camera.height_m:.3g} m below the camera would multiply its depth by "
            f"{1.0 / line.scale:.2f}"
        )

    def _share(self, name: str, rgb: Tensor, horizon: Horizon) -> Tensor:
        """Share of sky or own vehicle of each pixel, ``(H, W)``, given or found."""
        given = getattr(self, name)
        if name == "near_mask":
            found = find_near_mask(rgb) if given == "auto" else torch.zeros(1, *rgb.shape[-2:])
        elif given is None:
            from torchweather.camera.depth.sky import sky_mask

            found = sky_mask(rgb, horizon_row=horizon.row, vanishing_column=horizon.column)
        if isinstance(given, Tensor):
            found = given.detach().cpu()
        elif callable(given):
            found = torch.as_tensor(given(rgb))
        if found.shape[-2:] != rgb.shape[-2:] or found.numel() != rgb[0].numel():
            raise InputValueError(
                f"DepthNetwork: {name} must have the picture's size (1, {rgb.shape[-2]}, {rgb.shape[-1]}); got "
                f"{tuple(found.shape)}."
            )
        if not bool((found >= 0).all() & (found <= 1).all()):
            raise InputValueError(f"DepthNetwork: {name} must be shares 0..1. Divide 8-bit masks by 255.")
        return found.reshape(rgb.shape[-2:]).to(torch.float64)
