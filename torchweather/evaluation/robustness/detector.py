"""An ONNX detector in onnxruntime, compared with its declaration, fed with frames and clouds."""

from __future__ import annotations

import os
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.tone import develop
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.evaluation.robustness.declaration import Declaration
from torchweather.evaluation.robustness.decoders import TASKS
from torchweather.evaluation.robustness.graph import open_session
from torchweather.evaluation.robustness.graph_check import check_graph
from torchweather.evaluation.robustness.placement import Placement, placed
from torchweather.export import MosaicToImage

__all__ = ["OnnxDetector"]

Array = NDArray[Any]


class OnnxDetector:
    """A detector that onnxruntime runs on the CPU.

    Args:
        model: the ONNX file.
        declaration: its inputs, outputs and decoding; compared with the model here, before any frame.
        threads: of onnxruntime; 0 takes all cores.

    Raises:
        TorchweatherError: no ONNX graph, or inputs or outputs other than the declaration's.
    """

    def __init__(self, model: str | os.PathLike[str], declaration: Declaration, *, threads: int = 1) -> None:
        self.declaration = declaration
        self.session, graph = open_session(model, threads=threads)
        check_graph(graph, declaration)

    @cached_property
    def picture(self) -> MosaicToImage:
        """The step from a camera's frame to the declared input."""
        taken = self.declaration.input
        return MosaicToImage(
            exposure=taken["exposure"],
            colour="RGB" if taken["colour"] == "bayer" else taken["colour"],
            dtype="float32" if taken["dtype"] == "float16" else taken["dtype"],
            **{key: taken[key] for key in ("layout", "scale", "mean", "std")},
        )

    def developed(self, linear: Tensor, pattern: str) -> Tensor:
        """The sRGB picture ``(3, H, W)`` of a mosaic in linear light, in the declared exposure."""
        return develop(linear, pattern, exposure=self.declaration.input["exposure"]).clamp(0.0, 1.0)

    def of_frame(self, linear: Tensor | None, picture: Tensor) -> Any:
        """Boxes or classes that it finds in a camera's frame.

        Args:
            linear: mosaic ``(1, H, W)``, black 0, saturation 1; ``None`` of an RGB frame.
            picture: the sRGB picture ``(3, H, W)`` in [0, 1].
        """
        taken = self.declaration.input
        if taken["colour"] == "bayer":
            if linear is None:
                raise InputValueError(
                    f"{self.declaration.path}: the detector takes a mosaic; the frames are RGB images."
                )
            image = linear * taken["exposure"]
        else:
            image = picture
        image, place = placed(image, taken)
        given = self.picture.encoded(image[None])
        return self._decoded((given.half() if taken["dtype"] == "float16" else given).numpy(), place)

    def of_cloud(self, points: Tensor) -> Any:
        """Number of the class of every point ``(N,)`` of a cloud ``(N, C)``."""
        columns = self.declaration.input["columns"]
        if points.shape[-1] < columns:
            raise InputValueError(
                f"{self.declaration.path}: the detector takes {columns} columns; the cloud has {points.shape[-1]}."
            )
        given = points[:, :columns].float().numpy()
        found = self._decoded(given[None] if self.declaration.input["batch"] else given, None)
        if len(found) != len(points):
            raise TorchweatherError(
                f"{self.declaration.path}: expected logits for each of {len(points)} points; got {len(found)}."
            )
        return found

    def _decoded(self, given: Array, place: Placement | None) -> Any:
        roles = self.declaration.outputs
        names = [name for every in roles.values() for name in every]
        try:
            arrays = self.session.run(names, {self.declaration.input["name"]: np.ascontiguousarray(given)})
        except Exception as error:  # onnxruntime's own classes are not public
            reason = " ".join(str(error).split())
            raise TorchweatherError(
                f"the detector cannot run on an input of shape {given.shape} ({given.dtype}): {reason}"
            ) from error
        found = iter(arrays)
        outputs = {role: [next(found) for _ in every] for role, every in roles.items()}
        return TASKS[self.declaration.task](outputs, self.declaration, place)
