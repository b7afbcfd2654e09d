"""Fog of a camera's frames: light of the scene that is lost over depth, and airlight that is gained."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Weather
from torchweather.camera.bayer import cfa_index
from torchweather.camera.fog import ExtinctionAndAirlight
from torchweather.camera.rays import rays_of_frame
from torchweather.camera.sensor import Camera
from torchweather.evaluation.fit.least_squares import Model, Statistics, trimmed_mean
from torchweather.gap.study.study import Condition, Study

__all__ = ["ESTIMATORS", "camera_loss_per_m", "camera_models"]

ESTIMATORS = ("contrast", "all_light", "sky_airlight", "measured_airlight")
DEPTH_BINS = 24
LENGTHS = 8  # of a cell: the mean of its transmissions
LEAST_PIXELS = 16
NEIGHBOURS = 8
SATURATED = 0.95
LEAST_SKY = 0.005  # of the frame
HORIZON = 0.1  # of the sky's pixels, the lowest
COLOURS = ("red", "green", "blue")
GREEN = 1
EXTINCTION = "extinction_per_m"

Array = NDArray[np.float64]
Mask = NDArray[np.bool_] | None
Models = dict[str, tuple[Statistics, Model]]


@lru_cache(maxsize=1024)
def camera_loss_per_m(weather: Weather, camera: Camera) -> float:
    """Extinction of fog in green (clear, in an RCCB sensor), 1/m."""
    return float(_extinction(weather, camera)[GREEN])


def _extinction(weather: Weather, camera: Camera) -> Array:
    """By colour of the filter array."""
    assert isinstance(weather, Fog)
    stage = ExtinctionAndAirlight(weather, tuple(camera.bands.values()))
    return stage.extinction_per_m(1)[0].double().numpy()


def camera_models(study: Study, condition: Condition, left_out: Mask) -> tuple[Models, dict[str, str]]:
    """Means of cells of one depth, one colour, and dark or bright in clear air.

    Args:
        study, condition: of a camera, in fog.
        left_out: ``(H, W)``, True for pixels that do not count.
    """
    camera, scene = study.sensor_as(Camera), study.scene_of(condition)
    depth_m = np.asarray(scene.geometry["depth_m"], dtype=np.float64)
    clear = [np.asarray(scene.clear[k]["bayer"], dtype=np.float64) for k in range(len(scene.clear))]
    # Dark and bright are told by some clear frames and measured in the others: else noise would count as contrast.
    sorting = max(1, len(clear) // 4)
    order, clear = np.mean(clear[:sorting], axis=0), clear[sorting:]
    used = np.isfinite(depth_m) if left_out is None else np.isfinite(depth_m) & ~left_out
    height, width = depth_m.shape
    colour = cfa_index(height, width, camera.bayer_pattern).numpy()
    per_depth = rays_of_frame(camera, height, width, torch.zeros(1, dtype=torch.float64), float("inf")).per_depth
    cells = _cells(depth_m, depth_m * per_depth[0, 0].numpy(), colour, order, used)
    if len(cells.colour) < 8:
        return {}, dict.fromkeys(ESTIMATORS, "too few pixels at known depth")
    rows = Statistics(
        np.stack([cells.means(np.asarray(frame["bayer"], dtype=np.float64)) for frame in condition.frames]),
        np.stack([cells.means(frame) for frame in clear]),
    )
    lit = (rows.measured.max(0) < SATURATED) & (rows.clear.max(0) < SATURATED)
    rows = Statistics(np.where(lit, rows.measured, np.nan), np.where(lit, rows.clear, np.nan))
    extinction = _extinction(condition.weather, camera)  # type: ignore[arg-type]
    share = torch.from_numpy(np.ascontiguousarray(extinction / extinction[GREEN]))[cells.colour]
    length = torch.from_numpy(cells.length_m)
    which = torch.from_numpy(cells.colour)
    start = torch.tensor([float(extinction[GREEN]), 1.0], dtype=torch.float64)
    names = (EXTINCTION, "exposure_gain")

    def through(loss: Tensor) -> Tensor:
        return torch.exp(-loss * share[:, None] * length).mean(-1)

    def pairs(parameters: Tensor, light: Tensor) -> Tensor:
        passed = through(parameters[0]).reshape(-1, 2).mean(-1)  # dark and bright of one depth
        return parameters[1] * light * passed

    def all_light(parameters: Tensor, light: Tensor) -> Tensor:
        passed = through(parameters[0])
        return parameters[1] * (light * passed + parameters[2:][which] * (1 - passed))

    contrast = Statistics(*(each[:, 1::2] - each[:, ::2] for each in (rows.measured, rows.clear)))
    far = trimmed_mean(rows.measured)
    guess = [float(np.nanmean(far[cells.colour == k])) for k in range(3)]
    found: Models = {
        "contrast": (contrast, Model(pairs, start, names)),
        "all_light": (
            rows,
            Model(
                all_light,
                torch.cat([start, torch.tensor(guess, dtype=torch.float64)]),
                (*names, *(f"airlight_{colour}" for colour in COLOURS)),
            ),
        ),
    }
    why: dict[str, str] = {}
    sky = np.isinf(depth_m) if left_out is None else np.isinf(depth_m) & ~left_out
    lights: dict[str, tuple[Array, bool]] = {}
    if sky.mean() >= LEAST_SKY:
        middle = np.mean(clear, axis=0)
        # Light of the horizon: what the way to it gains is the airlight (Koschmieder).
        rows_down = np.broadcast_to(np.arange(len(sky))[:, None], sky.shape)
        sky &= rows_down >= np.quantile(rows_down[sky], 1 - HORIZON)
        lights["sky_airlight"] = np.array([middle[sky & (colour == k)].mean() for k in range(3)]), True
    else:
        why["sky_airlight"] = "no sky (depth inf) in these frames"
    if condition.airlight is not None:
        lights["measured_airlight"] = np.array(condition.airlight), False
    else:
        why["measured_airlight"] = "the condition states no airlight"
    for name, (light, exposed) in lights.items():
        fixed = torch.from_numpy(light)[which]

        def known(parameters: Tensor, own: Tensor, fixed: Tensor = fixed, exposed: bool = exposed) -> Tensor:
            passed = through(parameters[0])
            # The sky of clear frames has their exposure. Airlight measured in the weather has that of its own frames.
            gain = parameters[1] if exposed else 1.0
            return parameters[1] * own * passed + gain * fixed * (1 - passed)

        found[name] = (rows, Model(known, start, names))
    if condition.exposure_gain is not None:
        found = {name: (rows, _with_gain(model, condition.exposure_gain)) for name, (rows, model) in found.items()}
    return found, why


def _with_gain(model: Model, exposure_gain: float) -> Model:
    """The model with a gain that is known: its second parameter is none any more."""
    gain = torch.tensor([exposure_gain], dtype=torch.float64)

    def known(parameters: Tensor, light: Tensor) -> Tensor:
        return model.predict(torch.cat([parameters[:1], gain, parameters[1:]]), light)

    start = torch.cat([model.start[:1], model.start[2:]])
    return replace(model, predict=known, start=start, names=(model.names[0], *model.names[2:]))


class _Cells:
    """Pixels of one depth and colour, dark (even) and bright (odd) in clear air."""

    def __init__(self) -> None:
        self.pixels: list[NDArray[np.int64]] = []
        self.lengths: list[Array] = []
        self.colours: list[int] = []

    @property
    def colour(self) -> NDArray[np.int64]:
        return np.array(self.colours, dtype=np.int64)

    @property
    def length_m(self) -> Array:
        return np.stack(self.lengths)

    def means(self, frame: Array) -> Array:
        flat = frame.reshape(-1)
        return np.array([flat[each].mean() for each in self.pixels])


def _cells(depth_m: Array, length_m: Array, colour: NDArray[np.int64], order: Array, used: NDArray[np.bool_]) -> _Cells:
    found = _Cells()
    flat_length, flat_order = length_m.reshape(-1), order.reshape(-1)
    edges = np.quantile(depth_m[used], np.linspace(0.0, 1.0, DEPTH_BINS + 1)) if used.any() else np.zeros(2)
    places = (np.arange(LENGTHS) + 0.5) / LENGTHS
    for low, high in pairwise(edges):
        if high <= low:
            continue
        inside = used & (depth_m >= low) & ((depth_m < high) | (high == edges[-1]))
        for k in range(3):
            pixels = np.flatnonzero(inside & (colour == k))
            if len(pixels) < 2 * LEAST_PIXELS:
                continue
            for half in _halves(pixels[np.argsort(flat_length[pixels], kind="stable")], flat_order):
                found.pixels.append(half)
                found.lengths.append(np.quantile(flat_length[half], places))
                found.colours.append(k)
    return found


def _halves(by_length: NDArray[np.int64], order: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The darker and the brighter half of each few neighbours in length, so that both halves lie at one depth."""
    count = len(by_length) // NEIGHBOURS * NEIGHBOURS
    few = by_length[:count].reshape(-1, NEIGHBOURS)
    few = np.take_along_axis(few, np.argsort(order[few], axis=1, kind="stable"), axis=1)
    return few[:, : NEIGHBOURS // 2].reshape(-1), few[:, NEIGHBOURS // 2 :].reshape(-1)
