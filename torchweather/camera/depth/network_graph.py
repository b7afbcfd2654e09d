"""A depth network's ONNX graph: opened once, compared with what a depth network must take and give."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import TorchweatherError

__all__ = ["NetworkGraph", "open_graph"]

Array = npt.NDArray[np.floating[Any]]

_FLOATS = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
# Sessions kept open: one source a frame shares its network with the others.
_OPEN_SESSIONS = 4


@dataclass(frozen=True, eq=False)
class NetworkGraph:
    """An opened graph with one picture in and one map out.

    Args:
        session: of onnxruntime.
        path: of the file.
        input_name: of the picture.
        channels_first: the picture is ``(1, 3, H, W)``, else ``(1, H, W, 3)``.
        size: height and width that the graph fixes, pixels; ``None`` where it leaves that one open.
        output_name: of the map.
        dtype: of the picture.
    """

    session: Any
    path: str
    input_name: str
    channels_first: bool
    size: tuple[int | None, int | None]
    output_name: str
    dtype: Any

    def run(self, picture: Array) -> Array:
        """The map ``(h, w)`` of a normalised picture ``(3, H, W)``.

        Raises:
            TorchweatherError: the network fails, or gives no map or no finite numbers.
        """
        given = picture[None] if self.channels_first else np.moveaxis(picture, 0, -1)[None]
        try:
            (found,) = self.session.run(
                [self.output_name], {self.input_name: np.ascontiguousarray(given.astype(self.dtype))}
            )
        except Exception as error:  # onnxruntime's own classes are not public
            reason = " ".join(str(error).split())
            raise TorchweatherError(
                f"{self.path}: the network cannot run on an input of shape {given.shape}: {reason} If its sizes must "
                "be multiples of a number, give multiple_px (--depth-model-multiple-px)."
            ) from error
        sizes = [size for size in found.shape if size != 1]
        if len(sizes) != 2:
            raise TorchweatherError(
                f"{self.path}: the output {self.output_name} must be one map (1, 1, H, W), (1, H, W) or (H, W) for one "
                f"picture; got {found.shape}."
            )
        depth_map: Array = found.reshape(sizes).astype(np.float32)
        if not np.isfinite(depth_map).all():
            raise TorchweatherError(
                f"{self.path}: the output {self.output_name} must be finite; got "
                f"{int((~np.isfinite(depth_map)).sum())} other values of {depth_map.size}. Check mean and std."
            )
        return depth_map


def open_graph(
    path: str, providers: tuple[str, ...], threads: int, layout: str | None, output_name: str | None
) -> NetworkGraph:
    """The graph of a file, checked; a session that is open already is used again.

    Args:
        path: of the ONNX file.
        providers: of onnxruntime, in order.
        threads: of onnxruntime; 0 takes all cores.
        layout: ``NCHW`` or ``NHWC``; ``None``: where the graph has its three channels.
        output_name: of the map, where the graph gives several.

    Raises:
        TorchweatherError: the file is missing or no ONNX graph; inputs or outputs are not those of a depth network.
    """
    try:
        stamp = os.stat(path).st_mtime_ns
    except OSError as error:
        raise TorchweatherError(f"{path}: no such file; expected a depth network as an ONNX graph.") from error
    session = _session(os.path.abspath(path), stamp, providers, threads)
    inputs, outputs = session.get_inputs(), session.get_outputs()
    text = f"{path} takes {_ports(inputs)} and gives {_ports(outputs)}"
    if len(inputs) != 1:
        raise TorchweatherError(f"DepthNetwork: expected a graph with one input, a picture; {text}.")
    picture = inputs[0]
    if picture.type not in _FLOATS or len(picture.shape) != 4:
        raise TorchweatherError(
            f"DepthNetwork: expected a float picture (1, 3, H, W) or (1, H, W, 3) as input; {text}."
        )
    first = _channels_first(picture.shape, layout, text)
    if isinstance(picture.shape[0], int) and picture.shape[0] != 1:
        raise TorchweatherError(f"DepthNetwork: expected a batch of 1 or of open size; {text}. Export it so.")
    sides = picture.shape[2:] if first else picture.shape[1:3]
    height, width = (side if isinstance(side, int) and side > 0 else None for side in sides)
    chosen = _output(outputs, output_name, text)
    return NetworkGraph(session, path, picture.name, first, (height, width), chosen, _FLOATS[picture.type])


def _channels_first(shape: list[Any], layout: str | None, text: str) -> bool:
    fits = {"NCHW": shape[1] == 3 or not isinstance(shape[1], int), "NHWC": shape[3] == 3}
    if layout is None:
        layout = "NCHW" if fits["NCHW"] and not (fits["NHWC"] and shape[1] != 3) else "NHWC"
    if not fits[layout] and not (layout == "NHWC" and not isinstance(shape[3], int)):
        raise TorchweatherError(f"DepthNetwork: expected a picture with 3 channels ({layout}); {text}.")
    return layout == "NCHW"


def _output(outputs: list[Any], name: str | None, text: str) -> str:
    maps = [one for one in outputs if one.type in _FLOATS and _may_be_map(one.shape)]
    if name is not None:
        if name not in [one.name for one in outputs]:
            raise TorchweatherError(f"DepthNetwork: output_name must be one of the graph's; got {name!r}; {text}.")
        maps = [one for one in maps if one.name == name]
    if not maps:
        raise TorchweatherError(
            f"DepthNetwork: expected a float map (1, 1, H, W), (1, H, W) or (H, W) as output; {text}."
        )
    if len(maps) > 1:
        names = ", ".join(one.name for one in maps)
        raise TorchweatherError(
            f"DepthNetwork: {len(maps)} outputs may be the depth map ({names}); name one by output_name; {text}."
        )
    return str(maps[0].name)


def _may_be_map(shape: list[Any] | None) -> bool:
    """One value per pixel: at most two sizes other than 1, and no fixed number of channels."""
    if not shape:
        return True
    fixed = [size for size in shape if isinstance(size, int) and size != 1]
    return 2 <= len(shape) <= 4 and len(fixed) <= 2 and not (len(shape) == 4 and _channels(shape))


def _channels(shape: list[Any]) -> bool:
    """Check whether a map of four sizes has several channels wherever they stand."""
    return not any(size == 1 or not isinstance(size, int) for size in (shape[1], shape[3]))


def _ports(ports: list[Any]) -> str:
    return ", ".join(
        f"{one.name} {one.type.removeprefix('tensor(').removesuffix(')')} "
        f"({', '.join(str(size if size is not None else '?') for size in one.shape)})"
        for one in ports
    )


@lru_cache(maxsize=_OPEN_SESSIONS)
def _session(path: str, stamp: int, providers: tuple[str, ...], threads: int) -> Any:
    """An onnxruntime session; ``stamp`` opens a changed file anew."""
    import onnxruntime

    missing = [name for name in providers if name not in onnxruntime.get_available_providers()]
    if missing:
        raise TorchweatherError(
            f"DepthNetwork: providers {', '.join(missing)} are not in this onnxruntime; it has "
            f"{', '.join(onnxruntime.get_available_providers())}."
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = threads, 3
    try:
        return onnxruntime.InferenceSession(path, options, providers=list(providers))
    except Exception as error:  # onnxruntime's own classes are not public
        reason = " ".join(str(error).split())
        raise TorchweatherError(f"{path}: expected an ONNX graph; it cannot be read ({reason}).") from error
