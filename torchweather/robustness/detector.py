"""An ONNX detector in onnxruntime, held against its declaration, fed with frames and clouds."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from torchweather.errors import TorchweatherError, nearest_name
from torchweather.export import MosaicToImage
from torchweather.image import develop
from torchweather.robustness.declaration import Declaration
from torchweather.robustness.decoders import DECODERS

__all__ = ["OnnxDetector"]

Array = NDArray[Any]
FEWEST_PX = 4  # of a side of an image; less is the axis of the colours
ONNX_TYPES = {"float32": "tensor(float)", "uint8": "tensor(uint8)"}


class OnnxDetector:
    """A detector that onnxruntime runs on the CPU.

    Args:
        model: the ONNX file.
        declaration: what it takes and gives; checked against the model.
        threads: of onnxruntime; 0 takes all cores.

    Raises:
        TorchweatherError: no ONNX graph, or inputs or outputs other than the declaration's.
    """

    def __init__(self, model: str | os.PathLike[str], declaration: Declaration, *, threads: int = 1) -> None:
        import onnxruntime

        self.declaration = declaration
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.log_severity_level = threads, 3
        name = os.fspath(model)
        if not os.path.isfile(name):
            raise TorchweatherError(f"{name}: no such file.")
        try:
            self.session = onnxruntime.InferenceSession(name, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own classes are not public
            reason = " ".join(str(error).split())
            raise TorchweatherError(f"{name}: wanted an ONNX graph; it cannot be read ({reason}).") from error
        self._check(name)
        taken = declaration.input
        self.picture = (
            MosaicToImage(
                exposure=taken["exposure"],
                colour="RGB" if taken["colour"] == "bayer" else taken["colour"],
                **{key: taken[key] for key in ("layout", "dtype", "scale", "mean", "std")},
            )
            if declaration.sensor == "camera"
            else None
        )

    def developed(self, linear: Tensor, pattern: str) -> Tensor:
        """The sRGB picture ``(3, H, W)`` of a mosaic in linear light, in the declared exposure."""
        return develop(linear, pattern, exposure=self.declaration.input["exposure"]).clamp(0.0, 1.0)

    def of_frame(self, linear: Tensor | None, picture: Tensor) -> Any:
        """What it finds in a camera's frame.

        Args:
            linear: mosaic ``(1, H, W)``, black 0, saturation 1; ``None`` of an RGB frame.
            picture: the sRGB picture ``(3, H, W)`` in [0, 1].
        """
        assert self.picture is not None
        taken = self.declaration.input
        if taken["colour"] == "bayer":
            if linear is None:
                raise ValueError(f"{self.declaration.path}: the detector takes a mosaic; the frames are RGB images.")
            image = linear * taken["exposure"]
        else:
            image = picture
        frame = (int(image.shape[-2]), int(image.shape[-1]))
        if taken["size"] is not None and tuple(taken["size"]) != frame:
            image = F.interpolate(
                image[None], size=tuple(taken["size"]), mode="bilinear", antialias=True, align_corners=False
            )[0].clamp(0, 1)
        given = self.picture.encoded(image[None])
        size = (int(image.shape[-2]), int(image.shape[-1]))
        return self._decoded(given.numpy(), size, frame)

    def of_cloud(self, points: Tensor) -> Any:
        """Number of the class of every point ``(N,)`` of a cloud ``(N, C)``."""
        columns = self.declaration.input["columns"]
        if points.shape[-1] < columns:
            raise ValueError(
                f"{self.declaration.path}: the detector takes {columns} columns; the cloud has {points.shape[-1]}."
            )
        given = points[:, :columns].float().numpy()
        found = self._decoded(given[None] if self.declaration.input["batch"] else given, (0, 0), (0, 0))
        if len(found) != len(points):
            raise TorchweatherError(
                f"{self.declaration.path}: wanted logits for each of {len(points)} points; got {len(found)}."
            )
        return found

    def _decoded(self, given: Array, taken: tuple[int, int], frame: tuple[int, int]) -> Any:
        names = self.declaration.outputs
        try:
            found = self.session.run([*names.values()], {self.declaration.input["name"]: np.ascontiguousarray(given)})
        except Exception as error:  # onnxruntime's own classes are not public
            reason = " ".join(str(error).split())
            raise TorchweatherError(
                f"the detector cannot run on an input of shape {given.shape} ({given.dtype}): {reason}"
            ) from error
        return DECODERS[self.declaration.decoder](dict(zip(names, found, strict=True)), self.declaration, taken, frame)

    def _check(self, model: str) -> None:
        declared, where = self.declaration.input, self.declaration.path
        inputs = {each.name: each for each in self.session.get_inputs()}
        outputs = {each.name: each for each in self.session.get_outputs()}
        has = f"{model} takes {_signature(inputs)} and gives {_signature(outputs)}"
        if {*inputs} != {declared["name"]}:
            raise TorchweatherError(
                f"{where}: the declaration says input {declared['name']!r}; {has}."
                f"{'' if declared['name'] in inputs else nearest_name(declared['name'], inputs)}"
            )
        for role, name in self.declaration.outputs.items():
            if name not in outputs:
                raise TorchweatherError(
                    f"{where}: the declaration says output {name!r} for {role}; {has}.{nearest_name(name, outputs)}"
                )
        taken = inputs[declared["name"]]
        wanted, kind = _wanted(self.declaration)
        fits = len(taken.shape) == len(wanted) and all(map(_fits, taken.shape, wanted))
        if not fits or taken.type != ONNX_TYPES[kind]:
            shape = ", ".join(map(str, wanted))
            raise TorchweatherError(f"{where}: the declaration says {declared['name']} {kind} ({shape}); {has}.")


def _wanted(declaration: Declaration) -> tuple[list[int | str], str]:
    """Shape and type of the input as declared."""
    taken = declaration.input
    if declaration.sensor == "lidar":
        return [*([1] if taken["batch"] else []), "N", int(taken["columns"])], "float32"
    colours = 1 if taken["colour"] == "bayer" else 3
    height, width = taken["size"] or ("H", "W")
    shape = [1, colours, height, width] if taken["layout"] == "NCHW" else [1, height, width, colours]
    return shape, str(taken["dtype"])


def _fits(own: object, said: object) -> bool:
    """Whether a model's size can be the declared one: equal, or one of them open; three rows would be colours."""
    if isinstance(own, int) and isinstance(said, int):
        return own == said
    return said not in ("H", "W") or not isinstance(own, int) or own >= FEWEST_PX


def _signature(values: dict[str, Any]) -> str:
    kinds = {kind: name for name, kind in ONNX_TYPES.items()}
    return ", ".join(
        f"{name} {kinds.get(each.type, each.type)} ({', '.join(map(str, each.shape))})" for name, each in values.items()
    )
