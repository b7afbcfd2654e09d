"""A camera transform as one ONNX graph, with its noise, its knob and the intrinsics as inputs.

The graph draws nothing; ``draw_feed`` makes its noise inputs from a seed.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from torchweather.export.feed import METADATA_KEY, variates_to_metadata
from torchweather.image.bayer import cfa_colour_index
from torchweather.random import draw_variates, sizes_of
from torchweather.stages import CameraState, ExtinctionAndAirlight, ParticleVeil
from torchweather.transforms.camera import BayerWeather

__all__ = ["to_onnx"]

INTRINSICS = ("fx", "fy", "cx", "cy")
OPSET = 20


class _Graph(nn.Module):
    """A camera transform as a function of tensors only."""

    def __init__(self, transform: BayerWeather) -> None:
        super().__init__()
        self.chain = transform.chain
        self.camera = transform.camera
        self.register_buffer("cfa_index", torch.tensor(cfa_colour_index(self.camera.bayer_pattern)))
        self.cfa_index: Tensor
        self.variates = {
            f"{name}.{variate.name}": variate
            for name, stage in self.chain.stages.items()
            for variate in stage.variates()
        }
        self.knobs = _knobs(transform)

    def forward(
        self, bayer: Tensor, depth: Tensor, intrinsics: list[Tensor], knobs: list[Tensor], noise: list[Tensor]
    ) -> Tensor:
        height, width = bayer.shape[-2:]
        fx, fy, cx, cy = intrinsics
        x = (torch.arange(width, device=bayer.device).to(bayer.dtype) - cx) / fx
        y = (torch.arange(height, device=bayer.device).to(bayer.dtype) - cy) / fy
        x, y = self.camera.undistort(x[None, :], y[:, None])
        ray = torch.sqrt(1 + x.square() + y.square())[None, None]
        state = CameraState(
            signal=bayer,
            depth_m=depth,
            ray_per_depth=ray,
            cfa_index=self.cfa_index,
            intrinsics=torch.stack([fx, fy, cx, cy])[None],
        )
        named_noise = dict(zip(self.variates, noise, strict=True))
        named_knobs = dict(zip(self.knobs.values(), knobs, strict=True))
        after: CameraState = torch.func.functional_call(self.chain, named_knobs, (state, named_noise))
        return after.signal


def _knobs(transform: BayerWeather) -> dict[str, str]:
    """Graph input name to buffer name of every knob."""
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


def to_onnx(transform: BayerWeather, path: str | os.PathLike[str], *, height: int = 64, width: int = 96) -> list[str]:
    """Write a camera transform as an ONNX graph.

    Inputs: ``bayer`` and ``depth`` ``(1, 1, H, W)`` float32 (linear, black 0, saturation 1; metres), ``fx, fy, cx, cy``
    in pixels, the knob (``rate_mm_per_h`` or ``mor_m``, ``(1,)``), and the noise under its names (``draw_feed``).
    Output: ``signal`` ``(1, 1, H, W)``. H and W are dynamic and even.

    Args:
        transform: ``BayerRain``, ``BayerFog``, ``BayerSnow`` or ``BayerWeather``.
        path: where to write; under a temporary name first.
        height, width: size of the traced frame; any even size runs.

    Returns:
        Names of the graph's inputs, in order.

    Note:
        Lens distortion, pattern, exposure, cut and the size distribution are fixed in the graph. The focal length may
        be set freely; above the transform's own, the faintest listed particles become fewer. The margins around the
        frame, from which moving particles reach into it, are those of the transform's camera: for a frame much larger
        than it, with a tilted or distorting camera or a moving one, export the transform of the larger camera.

    Example:
        >>> from torchweather.sensors import Camera
        >>> from torchweather.transforms import BayerFog
        >>> from torchweather.weather import Fog
        >>> fog = BayerFog(Fog(mor_m=50), Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24))
        >>> to_onnx(fog, "fog.onnx")  # doctest: +SKIP
        ['bayer', 'depth', 'fx', 'fy', 'cx', 'cy', 'mor_m']
    """
    try:
        import onnx
        import onnx_ir  # noqa: F401  (comes with onnxscript)
        import onnxscript  # noqa: F401  (torch's exporter needs it)
    except ImportError as error:
        raise ImportError("to_onnx needs onnx and onnxscript: pip install 'torchweather[export]'.") from error
    if height % 2 or width % 2 or height < 4 or width < 4:
        raise ValueError(f"to_onnx: height and width must be even, 4 or more; got {height} x {width}.")
    if not isinstance(transform, BayerWeather):
        raise TypeError(
            "to_onnx: transform must be a Bayer transform, such as BayerRain(Rain(25), camera); got "
            f"{type(transform).__name__}."
        )
    target = Path(path)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"to_onnx: {target.parent}: no such folder.")
    device = next(transform.buffers()).device
    graph = _Graph(transform).to(device)
    arguments, shapes, names = _example(graph, height, width, device)
    with torch.no_grad(), warnings.catch_warnings():
        # The exporter's own: deprecated calls inside torch, and inputs that it names by position.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            graph,
            arguments,
            input_names=names,
            output_names=["signal"],
            dynamic_shapes=shapes,
            opset_version=OPSET,
            dynamo=True,
            optimize=False,
            verbose=False,
        )
    assert program is not None  # dynamo export always gives one
    _tidy(program.model)
    model = program.model_proto
    entry = model.metadata_props.add()
    entry.key = METADATA_KEY
    entry.value = variates_to_metadata(graph.variates)
    onnx.checker.check_model(model)
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(model.SerializeToString())
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return names


def _tidy(model: Any) -> None:
    """Fold constants, share equal nodes, drop unused ones; in place.

    The exporter's own ``optimize=True`` also tries every rewrite rule on every node, which takes a third of the whole
    export; onnxruntime does as much when it loads the graph.
    """
    from onnx_ir.passes import common
    from onnxscript import optimizer

    common.InlinePass()(model)
    optimizer.fold_constants(model)
    common.CommonSubexpressionEliminationPass()(model)
    optimizer.remove_unused_nodes(model)


def _example(
    graph: _Graph, height: int, width: int, device: torch.device
) -> tuple[tuple[Any, ...], tuple[Any, ...], list[str]]:
    """Arguments to trace with, their dynamic dimensions, and the names of the inputs."""
    sizes = sizes_of(height, width)
    half_h, half_w = torch.export.Dim("half_height", min=1), torch.export.Dim("half_width", min=1)
    dims = {"H": 2 * half_h, "W": 2 * half_w}
    frame = {2: dims["H"], 3: dims["W"]}
    noise, noise_shapes = [], []
    for number, (key, variate) in enumerate(graph.variates.items()):
        stage, _, _ = key.partition(".")
        array = draw_variates([0], stage, [variate], sizes)[key]
        noise.append(torch.from_numpy(array).to(device))
        if variate.law == "points":
            noise_shapes.append({1: torch.export.Dim(f"points_{number}", min=2)})
        else:
            noise_shapes.append({i + 1: dims[d] for i, d in enumerate(variate.shape) if isinstance(d, str)})
    knobs = [torch.full((1,), 50.0, device=device) for _ in graph.knobs]
    camera = graph.camera
    intrinsics = [torch.tensor(float(value), device=device) for value in camera.intrinsics]
    generator = torch.Generator().manual_seed(0)
    bayer = torch.rand(1, 1, height, width, generator=generator).to(device)
    depth = 5.0 + 20.0 * torch.rand(1, 1, height, width, generator=generator).to(device)
    arguments = (bayer, depth, intrinsics, knobs, noise)
    shapes: tuple[Any, ...] = (frame, frame, [{} for _ in intrinsics], [{} for _ in knobs], noise_shapes)
    return arguments, shapes, ["bayer", "depth", *INTRINSICS, *graph.knobs, *graph.variates]
