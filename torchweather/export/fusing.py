"""Weather and detector as one ONNX graph, so that onnxruntime alone can sweep the weather."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from torchweather.camera.rgb import AsBayer
from torchweather.camera.transform import BayerWeather
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, TorchweatherWarning
from torchweather.export.camera_graph import IMAGE_OUTPUTS
from torchweather.export.graph import OPSET, traced_model
from torchweather.export.joining import check_connection, inputs_of, join_models, signature_text
from torchweather.export.metadata import set_properties
from torchweather.lidar.transform import LidarWeather
from torchweather.radar.transform import RadarAttenuation

__all__ = ["fuse"]

# Of the weather's graph, what a detector takes where nothing else is said.
MAIN_OUTPUT = {
    BayerWeather: IMAGE_OUTPUTS["bayer"],
    AsBayer: IMAGE_OUTPUTS["rgb"],
    LidarWeather: "cloud",
    RadarAttenuation: "detections",
}
BETWEEN_HINT = (
    "Give between= a module that brings one into the form of the other, such as "
    "torchweather.export.MosaicToImage for mosaics and ImageToDetector for RGB images, or connect= where it is another "
    "input."
)


def fuse(
    transform: BayerWeather | AsBayer | LidarWeather | RadarAttenuation,
    detector: str | os.PathLike[str] | bytes | nn.Module | Any,
    path: str | os.PathLike[str],
    *,
    between: nn.Module | None = None,
    connect: Mapping[str, str] | None = None,
    outputs: Sequence[str] | None = None,
    keep: Sequence[str] = (),
    height: int = 64,
    width: int = 96,
    masks: bool = False,
    points: int = 1000,
    columns: int | None = None,
    directions: bool | None = None,
) -> list[str]:
    """Write a weather transform and a detector as one ONNX graph.

    Its inputs are those of ``to_onnx``: the clear data, the rate or visibility, the noise (``draw_feed``). Its outputs
    are the detector's. Sizes that both leave open stay open; where the detector fixes one, the data must have it.

    Args:
        transform: as in ``to_onnx``.
        detector: an ONNX file, its bytes or ``onnx.ModelProto``; or a torch module, which is exported first.
        path: where to write; under a temporary name first.
        between: from the weather's output to the detector's input, such as ``MosaicToImage`` or, behind
            ``AsBayer``, ``ImageToDetector``; exported with them.
        connect: input of the detector to output of the weather (``signal``, ``weathered``, ``cloud``, ``kind``,
            ``detections``, ...). Default: the only input, or the one called as the output is, gets ``signal``,
            ``weathered``, ``cloud`` or ``detections``.
            Inputs of the detector that are not connected become inputs of the graph.
        outputs: names for what a torch module gives; default its keys where it gives a dict, else ``output_0``, ...
        keep: outputs of the weather that the graph gives too, such as ``signal`` or ``kind``.
        height, width, masks, points, columns, directions: of the traced data, as in ``to_onnx``. Take those that the
            detector wants.

    Returns:
        Names of the graph's inputs, in order.

    Raises:
        ValueError: output and input do not fit; the message has the names, types and shapes of both.
        TorchweatherError: the detector is no ONNX graph, or its opset cannot be brought to the weather's.

    Note:
        The model's properties hold ``torchweather_version``, ``torchweather_transform``, ``torchweather_equations``
        (sections of PHYSICS.md), ``torchweather_units`` of every input, ``torchweather_seeds`` and the variates. The
        limits of ``to_onnx`` hold.

    Example:
        >>> from torchweather.sensors import Camera
        >>> from torchweather.transforms import BayerFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> fog = BayerFog(Fog(mor_m=50), Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24))
        >>> fuse(fog, "detector.onnx", "fused.onnx", between=MosaicToImage("RGGB"))  # doctest: +SKIP
        ['bayer', 'depth', 'fx', 'fy', 'cx', 'cy', 'mor_m']
    """
    target = Path(path)
    main = next((name for kind, name in MAIN_OUTPUT.items() if isinstance(transform, kind)), None)
    if main is None:
        raise InputTypeError(
            "fuse: transform must be a Bayer or LiDAR transform, AsBayer or RadarAttenuation; got "
            f"{type(transform).__name__}."
        )
    if not target.parent.is_dir():
        raise FileNotFoundError(f"fuse: {target.parent}: no such folder.")
    if between is not None and connect is not None and set(connect.values()) != {main}:
        raise InputValueError(f"fuse: between takes {main} alone; got connect={dict(connect)}.")
    # Before the weather's export, which takes long.
    opened: Any = None if isinstance(detector, nn.Module) else _opened(detector)
    weather, traceable, properties = traced_model(
        transform, height=height, width=width, masks=masks, points=points, columns=columns, directions=directions
    )
    for name in keep:
        if name not in {each.name for each in weather.graph.output}:
            raise InputValueError(
                f"fuse: keep must name outputs of the weather, {signature_text(weather.graph.output)}; got {name!r}."
            )
    joined, source = weather, main
    with torch.no_grad():
        example = _example(traceable.module, traceable.arguments, traceable.outputs.index(main))
    if isinstance(detector, nn.Module):
        module = detector if between is None else nn.Sequential(between, detector)
        opened = _exported(module, example, main, outputs)
    elif between is not None:
        middle = _exported(between, example, main, [f"{main}_between"])
        joined, source = join_models(weather, middle, {main: main}, keep=tuple(keep), name="between"), f"{main}_between"
    pairs = dict.fromkeys(connect or {}, source) if between is not None else dict(connect or {})
    if not pairs:
        pairs = {_only_input(joined, opened, source): source}
    for wanted, given in pairs.items():
        check_connection(joined, opened, given, wanted, hint=BETWEEN_HINT)
    fused = join_models(joined, opened, pairs, keep=tuple(keep))
    set_properties(fused, {**{each.key: each.value for each in opened.metadata_props}, **properties})
    fused.producer_name = "torchweather"
    with atomic_write(target) as unfinished:
        unfinished.write_bytes(fused.SerializeToString())
    return [each.name for each in fused.graph.input]


def _opened(detector: Any) -> Any:
    """The detector as onnx holds it."""
    import onnx

    if isinstance(detector, onnx.ModelProto):
        return detector
    name = "the bytes" if isinstance(detector, bytes) else os.fspath(detector)
    try:
        model = onnx.load_model_from_string(detector) if isinstance(detector, bytes) else onnx.load(name)
        onnx.checker.check_model(model)
    except FileNotFoundError as error:
        raise TorchweatherError(f"fuse: {name}: no such file.") from error
    except Exception as error:  # protobuf's and onnx's own
        reason = " ".join(str(error).split())
        raise TorchweatherError(f"fuse: {name}: expected an ONNX graph; it cannot be read ({reason}).") from error
    return model


def _only_input(weather: Any, detector: Any, source: str) -> str:
    inputs = inputs_of(detector)
    same = [each.name for each in inputs if each.name == source]
    if len(inputs) == 1 or same:
        return str((same or [inputs[0].name])[0])
    raise InputValueError(
        f"fuse: the detector takes {signature_text(inputs)}, and the weather gives "
        f"{signature_text(weather.graph.output)}: give connect={{input of the detector: output of the weather}}."
    )


def _example(module: nn.Module, arguments: tuple[Any, ...], number: int) -> Tensor:
    """Result of the weather for the traced data."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TorchweatherWarning)  # the traced scene is made up, and may show no sky
        found = module(*arguments)
    tensor: Tensor = found if isinstance(found, Tensor) else found[number]
    return tensor


def _exported(module: nn.Module, example: Tensor, name: str, outputs: Sequence[str] | None) -> Any:
    """A module of one tensor as onnx holds it, its sizes open where it allows that."""
    training = {inside: inside.training for inside in module.modules()}
    module.eval()
    try:
        with torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the exporter's own
            names = list(outputs) if outputs is not None else _names(module(example))
            auto = torch.export.Dim.AUTO
            if name in IMAGE_OUTPUTS.values():  # one image of one or three planes
                shape = {2: auto, 3: auto}
            else:  # a size of 1 never changes, nor do the columns of a cloud
                shape = {place: auto for place, size in enumerate(example.shape[:-1]) if size > 1}
            program = torch.onnx.export(
                module,
                (example,),
                input_names=[name],
                output_names=names,
                dynamic_shapes=(shape,),
                opset_version=OPSET,
                dynamo=True,
                optimize=False,
                verbose=False,
            )
    except Exception as error:
        reason = " ".join(str(error).split())[:400]
        raise TorchweatherError(
            f"fuse: {type(module).__name__} cannot be exported for {name} of shape {tuple(example.shape)} ({reason}). "
            "Give a size that it takes, or export it yourself and give the ONNX file."
        ) from error
    finally:
        for inside, was in training.items():
            inside.training = was
    assert program is not None  # dynamo export always gives one
    from torchweather.export.graph import tidy

    tidy(program.model)
    return program.model_proto


def _names(found: Any) -> list[str]:
    if isinstance(found, Mapping):
        return [str(key) for key in found]
    return [f"output_{number}" for number in range(len(found))] if isinstance(found, (tuple, list)) else ["output_0"]
