"""Inputs and outputs of an ONNX graph as onnxruntime reports them, in words."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torchweather.core.errors import TorchweatherError

__all__ = ["Graph", "Port", "open_session"]

TYPES = {"tensor(float)": "float32", "tensor(float16)": "float16", "tensor(double)": "float64"}


@dataclass(frozen=True)
class Port:
    """An input or output.

    Args:
        name: of the model.
        shape: sizes; text where the graph leaves them open. Empty where the graph does not give the shape.
        dtype: such as ``float32``, ``uint8``, ``int64``.
    """

    name: str
    shape: tuple[int | str, ...]
    dtype: str

    @property
    def text(self) -> str:
        """Name, type and shape."""
        return f"{self.name} {self.dtype} ({', '.join(map(str, self.shape))})"

    def without_batch(self, rank: int) -> tuple[int | str, ...]:
        """The shape of ``rank`` sizes; a batch of 1 or of open size before them is left out."""
        batched = len(self.shape) == rank + 1 and (self.shape[0] == 1 or isinstance(self.shape[0], str))
        return self.shape[1:] if batched else self.shape


@dataclass(frozen=True)
class Graph:
    """A model's inputs, outputs and remarks.

    Args:
        path: the file.
        inputs, outputs: by name.
        remarks: text that the exporter left in the file.
    """

    path: str
    inputs: Mapping[str, Port]
    outputs: Mapping[str, Port]
    remarks: Mapping[str, str]

    @property
    def text(self) -> str:
        """Inputs and outputs for an error."""
        taken, given = (", ".join(each.text for each in ports.values()) for ports in (self.inputs, self.outputs))
        return f"{self.path} takes {taken} and gives {given}"


def open_session(model: str | os.PathLike[str], *, threads: int = 1) -> tuple[Any, Graph]:
    """A session of onnxruntime on the CPU, and the graph's inputs and outputs.

    Raises:
        TorchweatherError: the file is missing or no ONNX graph.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = threads, 3
    name = os.fspath(model)
    if not os.path.isfile(name):
        raise TorchweatherError(f"{name}: no such file; expected the detector as an ONNX graph.")
    try:
        session = onnxruntime.InferenceSession(name, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own classes are not public
        reason = " ".join(str(error).split())
        raise TorchweatherError(f"{name}: expected an ONNX graph; it cannot be read ({reason}).") from error
    inputs, outputs = (
        {each.name: _port(each) for each in ports} for ports in (session.get_inputs(), session.get_outputs())
    )
    return session, Graph(name, inputs, outputs, dict(session.get_modelmeta().custom_metadata_map))


def _port(value: Any) -> Port:
    kind = TYPES.get(value.type) or value.type.removeprefix("tensor(").removesuffix(")")
    shape = tuple(size if isinstance(size, int) else str(size or "?") for size in value.shape)
    return Port(value.name, shape, kind)
