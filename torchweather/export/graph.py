"""A transform as one ONNX graph, with its noise, its weather intensity and what depends on the data as inputs.

The graph draws nothing; ``draw_feed`` makes its noise inputs from a seed.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from torchweather.camera.rgb import AsBayer
from torchweather.camera.transform import BayerWeather
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputTypeError, InputValueError, MissingExtraError
from torchweather.core.extras import install_hint
from torchweather.export.camera_graph import BAYER_FORM, RGB_FORM
from torchweather.export.decomposing import DecomposedByNode
from torchweather.export.lidar_graph import LIDAR_FORM
from torchweather.export.metadata import model_properties, set_properties
from torchweather.export.radar_graph import MAP_FORM, RADAR_FORM
from torchweather.export.tidying import simplify
from torchweather.export.traceable import GraphForm, GraphSizes, Traceable
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.graph_operations import writing_onnx
from torchweather.pipeline.sensor_transform import WeatherTransform
from torchweather.radar import RangeDopplerMap
from torchweather.radar.transform import RadarAttenuation

__all__ = ["to_onnx"]

OPSET = 20
FOLDED = 1 << 18  # entries of a table up to which it is computed when the graph is written
FORMS: dict[type, GraphForm] = {
    BayerWeather: BAYER_FORM,
    AsBayer: RGB_FORM,
    LidarWeather: LIDAR_FORM,
    RadarAttenuation: RADAR_FORM,
    RangeDopplerMap: MAP_FORM,
}


def to_onnx(
    transform: BayerWeather | AsBayer | LidarWeather | RadarAttenuation | RangeDopplerMap,
    path: str | os.PathLike[str],
    *,
    height: int = 64,
    width: int = 96,
    masks: bool = False,
    points: int = 1000,
    columns: int | None = None,
    directions: bool | None = None,
) -> list[str]:
    """Write a transform, or a radar's range-Doppler map, as an ONNX graph; everything in it is float32.

    Inputs of a camera's graph: ``bayer`` and ``depth`` ``(1, 1, H, W)`` (linear, black 0, saturation 1; metres),
    ``fx, fy, cx, cy`` in pixels, the intensity (``rate_mm_per_h`` or ``mor_m``, ``(1,)``), and the noise under its
    names (``draw_feed``). Output: ``signal`` ``(1, 1, H, W)``. H and W are dynamic and even.

    The graph of ``AsBayer``, for RGB images, has ``rgb`` ``(1, 3, H, W)`` in place of ``bayer`` and ``weathered`` in
    place of ``signal``, both sRGB-encoded in 0..1. A sample that the weather does not change keeps its bits. H and W
    may be odd.

    Inputs of a LiDAR's graph: ``points`` ``(B, N, columns)``, ``directions`` ``(N, 3)`` if asked for, the intensity
    ``(B,)``, and the noise. Outputs: ``cloud`` ``(B, N, columns)`` and ``kind`` ``(B, N)`` int8 (``PointKind``); for a
    dual-return sensor also ``second`` and ``second_kind``, whose row i is of the same beam as row i of ``points``. B
    and N are dynamic.

    Inputs of a radar's graph: ``points`` ``(B, N, columns)``, the weather intensity ``(B,)``, and the noise. Outputs:
    ``detections`` ``(B, N, columns)``, ``kind`` ``(B, N)`` int8, ``snr_db`` and ``attenuation_db`` ``(B, N)``; rows
    more with clutter. B and N are dynamic. A wet cover follows the rain's own rate.

    Inputs of a range-Doppler map's graph: ``real`` and ``imaginary`` ``(B, V, N_c, N_s)``, the parts of the samples.
    Outputs: ``map_real`` and ``map_imaginary`` ``(B, V, N_c, N_s)`` and ``power_dbm`` ``(B, N_c, N_s)``. B is dynamic.

    In a mixture of rain and snow the rates are ``rain_rate_mm_per_h`` and ``snow_rate_mm_per_h``.

    Args:
        transform: ``BayerRain``, ``LidarFog``, ... , ``BayerWeather``, ``LidarWeather``, ``RadarAttenuation``,
            ``torchweather.radar.RangeDopplerMap``, or ``AsBayer`` without ``through_mosaic``.
        path: where to write; under a temporary name first.
        height, width: of a camera's traced image; any even size runs, of RGB images any size.
        masks: of a camera's graph: take the shares of a ``SceneDepth`` as inputs ``sky`` and ``near_mask``,
            ``(1, 1, H, W)`` in 0..1. Default: the sky is where ``depth`` is infinite, and the own vehicle is not seen.
        points: of a LiDAR's traced cloud or a radar's list; any number runs.
        columns: of every cloud of a LiDAR (x, y, z, intensity) or list of a radar (x, y, z, speed, power, radar cross
            section) and others that are carried along; ``None``: these 4 or 6.
        directions: whether a LiDAR's graph takes the direction of every row, so that beams without return are simulated
            too; ``None``: if the transform's sensor has directions.

    Returns:
        Names of the graph's inputs, in order.

    Note:
        Camera: lens distortion, pattern, exposure, cut and the size distribution are fixed in the graph. The focal
        length may be set freely; above the transform's own, the faintest listed particles become fewer. The margins
        around the frame, from which moving particles reach into it, are those of the transform's camera: for a frame
        much larger than it, with a tilted or distorting camera or a moving one, export the transform of the larger
        camera. The mounting is fixed too: for a ``SceneDepth`` with a horizon row, export a camera of that pitch.

        LiDAR: sensor, return mode and the number of particles in a beam are fixed in the graph; the last follows from
        the transform's rate in the modes ``last``, ``first`` and ``dual``, so export the largest rate that will be fed.
        The graph checks nothing: coordinates must be finite and directions not 0.

        Radar: sensor, models and the wet cover are fixed in the graph. It checks nothing: numbers must be finite.

    Example:
        >>> from torchweather.sensors import Camera
        >>> from torchweather.transforms import BayerFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> fog = BayerFog(Fog(mor_m=50), Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24))
        >>> to_onnx(fog, "fog.onnx")  # doctest: +SKIP
        ['bayer', 'depth', 'fx', 'fy', 'cx', 'cy', 'mor_m']
    """
    target = Path(path)
    inner = getattr(transform, "transform", transform)
    if isinstance(inner, WeatherTransform):
        inner.refuse_nuisances()
    share = getattr(inner, "p", 1.0)
    if share != 1.0:
        raise InputValueError(
            f"to_onnx: a graph draws nothing and always has weather; got a transform with p={share:g}. Export one with "
            "p=1 and feed a rate of 0, or a visibility of infinity, to the samples that stay clear."
        )
    if not target.parent.is_dir():
        _form(transform, height, width)
        raise FileNotFoundError(f"to_onnx: {target.parent}: no such folder.")
    model, traceable, properties = traced_model(
        transform, height=height, width=width, masks=masks, points=points, columns=columns, directions=directions
    )
    set_properties(model, properties)
    with atomic_write(target) as unfinished:
        unfinished.write_bytes(model.SerializeToString())
    return traceable.inputs


def traced_model(
    transform: Any,
    *,
    height: int,
    width: int,
    points: int,
    columns: int | None,
    directions: bool | None,
    masks: bool = False,
) -> tuple[Any, Traceable, dict[str, str]]:
    """A transform as onnx holds it, what was traced, and what the graph says of itself; the arguments of `to_onnx`."""
    form = _form(transform, height, width)
    import onnx

    if masks and not form.takes_masks:
        raise InputValueError(
            f"to_onnx: masks=True adds shares of a camera's pixels; {type(transform).__name__} has none. Leave it out."
        )
    fewest = form.fewest_columns
    columns = fewest if columns is None else columns
    if points < 2 or columns < fewest:
        raise InputValueError(
            f"to_onnx: points must be 2 or more and columns {fewest} or more; got {points} and {columns}."
        )
    traceable = form.trace(transform, GraphSizes(height, width, points, columns, directions, masks))
    model = _traced(traceable)
    onnx.checker.check_model(model)
    return model, traceable, model_properties(traceable)


def _form(transform: object, height: int, width: int) -> GraphForm:
    """The graph of a transform's class; a size that it cannot have is refused."""
    try:
        import onnx  # noqa: F401
        import onnx_ir  # noqa: F401  (comes with onnxscript)
        import onnxscript  # noqa: F401  (torch's exporter needs it)
    except ImportError as error:
        raise MissingExtraError(f"to_onnx needs onnx and onnxscript. {install_hint('export')}") from error
    form = next((form for kind, form in FORMS.items() if isinstance(transform, kind)), None)
    if form is None:
        raise InputTypeError(
            "to_onnx: transform must be a Bayer transform, such as BayerRain(Rain(25), camera), AsBayer of one, a "
            "LiDAR transform, such as LidarRain(Rain(25), lidar), RadarAttenuation or RangeDopplerMap; got "
            f"{type(transform).__name__}."
        )
    if height < 4 or width < 4 or (form.whole_cells and (height % 2 or width % 2)):
        even = "even, " if form.whole_cells else ""
        raise InputValueError(f"to_onnx: height and width must be {even}4 or more; got {height} x {width}.")
    return form


def _traced(traceable: Traceable) -> Any:
    """The graph, as onnx holds it."""
    from torchweather.export.promoting import promoting_by_held_types

    with torch.no_grad(), warnings.catch_warnings(), _few_records(), promoting_by_held_types():
        # The exporter's own: deprecated calls inside torch, and inputs that it names by position.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            DecomposedByNode.of(_captured(traceable)),
            input_names=traceable.inputs,
            output_names=traceable.outputs,
            opset_version=OPSET,
            dynamo=True,
            optimize=False,
            verbose=False,
        )
    assert program is not None  # dynamo export always gives one
    tidy(program.model)
    return program.model_proto


def _captured(traceable: Traceable) -> torch.export.ExportedProgram:
    """The traced program, as ``torch.onnx.export`` captures it."""
    options: dict[str, Any] = {"strict": False, "prefer_deferred_runtime_asserts_over_guards": True}
    shapes: Any = traceable.dynamic_shapes
    # A size of 0 or 1 is no case of its own.
    with torch.fx.experimental._config.patch(backed_size_oblivious=True), writing_onnx():  # type: ignore[attr-defined]
        try:
            return torch.export.export(traceable.module, traceable.arguments, dynamic_shapes=shapes, **options)
        except torch._dynamo.exc.UserError as error:  # a size has another least value
            shapes = torch.export.dynamic_shapes.refine_dynamic_shapes_from_suggested_fixes(error.msg, shapes)
            return torch.export.export(traceable.module, traceable.arguments, dynamic_shapes=shapes, **options)


@contextmanager
def _few_records() -> Iterator[None]:
    """While it is open, torch keeps neither the source lines of every node nor tensors without data for later calls.

    Of sizes that are symbols, keeping such a tensor takes longer than making it: 30 % of a capture.
    """
    switches = [
        (torch.fx.config, "do_not_emit_stack_traces", True),
        (torch._dynamo.config, "fake_tensor_cache_enabled", False),
    ]
    known = [
        (config, name, getattr(config, name), wanted) for config, name, wanted in switches if hasattr(config, name)
    ]
    for config, name, _, wanted in known:
        setattr(config, name, wanted)
    try:
        yield
    finally:
        for config, name, before, _ in known:
            setattr(config, name, before)


def tidy(model: Any) -> None:
    """Fold constants, share equal nodes, drop unused ones; in place.

    The exporter's own ``optimize=True`` also tries every rewrite rule on every node, which takes a third of the whole
    export; onnxruntime does as much when it loads the graph.
    """
    from onnx_ir.passes import common
    from onnxscript import optimizer

    common.InlinePass()(model)
    optimizer.fold_constants(model, input_size_limit=FOLDED, output_size_limit=FOLDED)
    common.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0)(model)
    common.DeduplicateInitializersPass()(model)
    common.CommonSubexpressionEliminationPass()(model)
    simplify(model)
    optimizer.remove_unused_nodes(model)
    common.DeduplicateInitializersPass()(model)
    common.CommonSubexpressionEliminationPass()(model)
