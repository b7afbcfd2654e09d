"""The noise inputs of an exported graph, from a seed, without torch: the numbers that ``transform.draw`` gives."""

from __future__ import annotations

import json
import math
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.core.exceptions import InputValueError
from torchweather.core.random import Variate, draw_variates, sizes_of

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

__all__ = ["METADATA_KEY", "TRANSFORM_KEY", "draw_feed", "variates_to_metadata"]

METADATA_KEY = "torchweather_variates"
TRANSFORM_KEY = "torchweather_transform"
UNITS_KEY = "torchweather_units"  # of every input
LEVELS_KEY = "torchweather_levels"
"""Noise input to its ``rate``, an input of the graph, and to ``log_limit``: ln of the highest level of a point that is
shown at the rates ``exp(log_rate_low + i log_rate_step)``."""
RATE = "rate_mm_per_h"  # ends the name of an input that is a rate
RGB = "rgb"  # the image of a graph of three colour planes


class _Said(NamedTuple):
    """Noise inputs and their variates; the image that a camera's graph takes; ``LEVELS_KEY``; names of all inputs."""

    variates: dict[str, Variate]
    image: str | None
    levels: Mapping[str, Any]
    inputs: Sequence[str]


def draw_feed(
    model: str | os.PathLike[str] | bytes | InferenceSession,
    *,
    height: int | None = None,
    width: int | None = None,
    points: int | None = None,
    seed: int | Sequence[int],
    rates: Mapping[str, float] | None = None,
) -> dict[str, NDArray[np.float32]]:
    """The noise inputs of an exported graph for a size of the data and a seed, as numpy arrays.

    Args:
        model: the onnxruntime session that runs the graph, or the graph's file or bytes. A file is read anew where it
            has changed, bytes at each call.
        height, width: of a camera's frame, pixels; even where the graph takes a mosaic.
        points: rows of a LiDAR's cloud or a radar's list.
        seed: the sample's integer, or one for each sample of a batch; the numbers equal
            ``transform.draw(data, seed=seed)``.
        rates: of rain and snow, mm/h, under the names of the graph's inputs. Points that these rates do not show are
            left out: the graph gives the same and runs faster. The feed serves these rates alone, at the focal length
            of the exported camera or a shorter one. ``None``: it serves every rate.

    Returns:
        Input name to float32 array that leads with the batch, 1 for a single integer; empty where the graph needs none.

    Raises:
        TorchweatherError: the model was not written by ``to_onnx``.
    """
    variates, image, levels, inputs = _read(model)
    if rates is not None:
        variates = _as_shown(variates, levels, rates, inputs)
    sizes = _sizes(height, width, points, image)
    of_clouds = any("N" in variate.shape for variate in variates.values())
    if variates and of_clouds != ("N" in sizes):
        wanted, given = ("points", "height and width") if of_clouds else ("height and width", "points")
        raise InputValueError(f"draw_feed: the noise of this graph is made from {wanted}; got {given}.")
    seeds = [int(one) for one in seed] if isinstance(seed, Sequence) else [int(seed)]
    by_stage: dict[str, list[Variate]] = defaultdict(list)
    for key, variate in variates.items():
        by_stage[key.partition(".")[0]].append(variate)
    feed: dict[str, NDArray[np.float32]] = {}
    for stage, own in by_stage.items():
        feed.update(draw_variates(seeds, stage, own, sizes))
    return feed


def _sizes(height: int | None, width: int | None, points: int | None, image: str | None) -> dict[str, int]:
    """The named sizes of the data; ``image`` is ``bayer`` or ``rgb``, or ``None`` where the graph does not say."""
    if points is not None and height is None and width is None:
        if points < 0:
            raise InputValueError(f"draw_feed: points must be 0 or more; got {points}.")
        return {"N": points}
    if points is not None or height is None or width is None:
        raise InputValueError(
            "draw_feed: give height and width of a camera's frame, or the points of a LiDAR's cloud or a radar's list."
        )
    if image == RGB:
        if height < 1 or width < 1:
            raise InputValueError(f"draw_feed: height and width must be 1 px or more; got {height} x {width}.")
        return sizes_of(height, width, 3)
    if height < 2 or width < 2 or height % 2 or width % 2:
        raise InputValueError(f"draw_feed: height and width must be even, 2 px or more; got {height} x {width}.")
    return sizes_of(height, width)


def _as_shown(
    variates: Mapping[str, Variate], levels: Mapping[str, Any], rates: Mapping[str, float], inputs: Sequence[str]
) -> dict[str, Variate]:
    """The variates as far as some rates show them."""
    for name, rate in rates.items():
        if name not in inputs or not name.endswith(RATE):
            known = ", ".join(one for one in inputs if one.endswith(RATE)) or "none"
            raise InputValueError(f"draw_feed: rates: the graph's rates are {known}; got {name!r}.")
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0 <= rate < math.inf:
            raise InputValueError(f"draw_feed: rates[{name!r}]: expected a rate in mm/h, 0 or more; got {rate!r}.")
    return {
        key: replace(variate, level_limit=_level_limit(levels[key], rates[levels[key]["rate"]]))
        if key in levels and levels[key]["rate"] in rates
        else variate
        for key, variate in variates.items()
    }


def _level_limit(levels: Mapping[str, Any], rate: float) -> float:
    """The highest level that a rate shows; 1, all of them, outside the table."""
    if rate == 0:
        return 0.0
    limits = levels["log_limit"]
    place = (math.log(rate) - levels["log_rate_low"]) / levels["log_rate_step"]
    cell = math.floor(place)
    if not 0 <= cell < len(limits) - 1:
        return 1.0
    share = place - cell
    return math.exp(min(0.0, limits[cell] * (1 - share) + limits[cell + 1] * share))


def variates_to_metadata(variates: Mapping[str, Variate]) -> str:
    """Graph inputs and the variates that fill them, as the graph's metadata hold them."""
    return json.dumps([{"input": key, **variate.to_dict()} for key, variate in variates.items()])


def _read(model: str | os.PathLike[str] | bytes | InferenceSession) -> _Said:
    """The properties of a graph."""
    if hasattr(model, "get_modelmeta"):
        return _read_metadata(model.get_modelmeta().custom_metadata_map)
    if isinstance(model, bytes) or not os.path.isfile(model):
        return _read_metadata(_opened(model).get_modelmeta().custom_metadata_map)
    status = os.stat(model)
    return _read_file(os.fspath(model), os.path.abspath(model), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _read_file(path: str, absolute: str, changed_ns: int, size: int) -> _Said:
    """``_read`` of a file in one of its states; opening a graph takes twenty times as long as a draw."""
    return _read_metadata(_opened(path).get_modelmeta().custom_metadata_map)


def _read_metadata(said: Mapping[str, str]) -> _Said:
    text = said.get(METADATA_KEY)
    if text is None:
        from torchweather.core.exceptions import TorchweatherError

        raise TorchweatherError(
            "draw_feed: expected a graph written by torchweather.export.to_onnx; this one lacks the list of its noise "
            f"(metadata {METADATA_KEY!r})."
        )
    entries: Sequence[Mapping[str, Any]] = json.loads(text)
    variates = {entry["input"]: Variate(**{k: v for k, v in entry.items() if k != "input"}) for entry in entries}
    image = json.loads(said.get(TRANSFORM_KEY, "{}")).get("image")
    return _Said(variates, image, json.loads(said.get(LEVELS_KEY, "{}")), tuple(json.loads(said.get(UNITS_KEY, "{}"))))


def _opened(model: str | os.PathLike[str] | bytes) -> InferenceSession:
    import onnxruntime

    # Only the metadata are read: optimising the graph for it would take longer than the draw.
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 3
    source = model if isinstance(model, bytes) else os.fspath(model)
    try:
        return onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own classes are not public
        from torchweather.core.exceptions import TorchweatherError

        name = "the bytes" if isinstance(model, bytes) else os.fspath(model)
        raise TorchweatherError(f"draw_feed: {name}: expected an ONNX graph; {error}") from error
