"""Robust least squares of a differentiable model, for all bootstrap samples at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import stats
from torch import Tensor
from torch.func import vmap

from torchweather.core.random import keyed_stream
from torchweather.evaluation.fit.result import Value

__all__ = ["INTERVAL", "Fitted", "Model", "Statistics", "fitted", "trimmed_mean"]

INTERVAL = 0.9
TRIMMED = 0.2  # of the frames at either end: what passes by in one frame of five does not count
HUBER = 1.345  # 95 % efficient for normal residuals (Huber and Ronchetti, Robust Statistics, 2009, 4.5)
STEPS = 60
FLAT, STUCK = 1e-7, 1e3  # gain of a step that is none; damping at which no step helps
MISFIT_LEVEL = 0.99
# Residuals finer than this share of the largest statistic are rounding of the recordings, not scatter.
FINEST = 1e-4

Array = NDArray[np.float64]
Prediction = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Statistics:
    """Statistics of frames, a row for each frame.

    Args:
        measured: ``(F, K)`` of frames in weather; NaN where a frame has none.
        clear: ``(C, K)`` of clear frames.
        rounding: ``(K,)`` standard deviation of the measured statistics by the sensor's steps, the same in every frame;
            ``None``: there are none.
    """

    measured: Array
    clear: Array
    rounding: Array | None = None


@dataclass(frozen=True)
class Model:
    """Expected values of the measured statistics.

    Args:
        predict: ``(parameters (P,), clear statistics (K,)) -> (K,)``, differentiable.
        start: ``(P,)``.
        names: of the parameters, the loss of the path first.
    """

    predict: Prediction
    start: Tensor
    names: tuple[str, ...]


@dataclass(frozen=True)
class Fitted:
    """Parameters with intervals, and how well the model describes the frames."""

    values: Mapping[str, Value]
    misfit: float
    fits: bool
    cells: int


def trimmed_mean(values: Array) -> Array:
    """Mean over frames (second axis from the end) without the fifth at either end; NaN counts for nothing.

    Example:
        >>> trimmed_mean(np.array([[1.0], [2.0], [3.0], [4.0], [100.0]]))
        array([3.])
    """
    ordered = np.sort(values, axis=-2)  # NaN last
    count = np.isfinite(ordered).sum(-2, keepdims=True)
    rank = np.arange(values.shape[-2])[:, None]
    cut = np.floor(TRIMMED * count)
    kept = (rank >= cut) & (rank < count - cut)
    number = kept.sum(-2)
    found: Array = np.where(kept, ordered, 0.0).sum(-2) / np.maximum(number, 1)
    return np.where(number > 0, found, np.nan)


def fitted(statistics: Statistics, model: Model, *, bootstrap: int, seed: int) -> Fitted:
    """Fit a model to the frames, and to frames drawn from them with replacement.

    Means over frames are trimmed, residuals have Huber's loss. The interval is Student's t times the deviation of the
    bootstrap, ``n / (n - 1)`` larger in variance, since a bootstrap of few frames scatters too little; and the root of
    the misfit larger where that is above 1 (Birge 1932): what the model does not describe makes its parameters
    uncertain, too.
    """
    stream = keyed_stream(seed, "evaluation.fit.bootstrap")
    sides = []
    for values in (statistics.measured, statistics.clear):
        rows = stream.integers(len(values), size=(bootstrap, len(values)))
        rows = np.concatenate([np.arange(len(values))[None], rows])  # the first sample: the frames themselves
        sides.append(trimmed_mean(values[rows]))
    rounding = np.zeros(statistics.measured.shape[1]) if statistics.rounding is None else statistics.rounding
    sides[0][1:] += rounding * stream.standard_normal((bootstrap, len(rounding)))
    kept = np.isfinite(sides[0]).all(0) & np.isfinite(sides[1]).all(0)
    variance = _variance(statistics.measured)[kept] + _variance(statistics.clear)[kept] + np.square(rounding[kept])
    finest = FINEST * np.abs(sides[0][0, kept]).max(initial=0.0)
    weight = 1.0 / np.maximum((variance + np.median(variance)) / 2, finest**2 + 1e-30)
    measured, clear = (torch.from_numpy(side[:, kept]) for side in sides)

    of_all, kept_ones = torch.from_numpy(np.maximum(np.cumsum(kept) - 1, 0)), torch.from_numpy(np.flatnonzero(kept))

    def predict(parameters: Tensor, x: Tensor) -> Tensor:
        return model.predict(parameters, x[of_all])[kept_ones]

    found = _levenberg_marquardt(predict, model.start.double(), clear, measured, torch.from_numpy(weight))
    residual = (measured[0] - predict(found[0], clear[0])).detach().numpy()
    freedom = int(kept.sum()) - len(model.start)
    chi_square = float(np.sum(weight * np.square(residual)))
    misfit = chi_square / freedom
    frames = min(len(statistics.measured), len(statistics.clear))
    wider = np.sqrt(max(1.0, misfit))
    held: dict[str, Value] = {}
    for place, name in enumerate(model.names):
        drawn = found[1:, place].numpy()
        low = high = float("nan")
        value = float(found[0, place])
        if frames > 1:
            ends = np.quantile(drawn, [0.158655, 0.841345])
            deviation = float(ends[1] - ends[0]) / 2 * np.sqrt(frames / (frames - 1)) * wider
            reach = float(stats.t.ppf((1 + INTERVAL) / 2, frames - 1)) * deviation
            low, high = value - reach, value + reach
        held[name] = Value(value, low, high)
    fits = chi_square <= float(stats.chi2.ppf(MISFIT_LEVEL, freedom))
    return Fitted(held, misfit, fits, int(kept.sum()))


def _variance(values: Array) -> Array:
    """Of the mean over frames, ``(K,)``; 0 for one frame."""
    count = np.isfinite(values).sum(0)
    centre = np.where(np.isfinite(values), values, 0.0).sum(0) / np.maximum(count, 1)
    spread = np.where(np.isfinite(values), np.square(values - centre), 0.0).sum(0)
    return np.where(count > 1, spread / np.maximum(count - 1, 1) / np.maximum(count, 1), 0.0)


def _levenberg_marquardt(predict: Prediction, start: Tensor, x: Tensor, y: Tensor, weight: Tensor) -> Tensor:
    """Parameters ``(B, P)`` of every sample. Marquardt (1963), with Huber's weights."""
    model = vmap(predict)
    parameters = start.expand(len(x), -1).clone()
    root = weight.sqrt()

    def scaled(values: Tensor) -> Tensor:
        return (y - model(values, x)) * root

    residual = scaled(parameters)
    damping = torch.full((len(x), 1), 1e-3, dtype=torch.float64)
    for _ in range(STEPS):
        scale = (1.4826 * residual.abs().median(-1, keepdim=True).values).clamp_min(1.0)
        share = (HUBER * scale / residual.abs().clamp_min(1e-12)).clamp_max(1.0)
        jacobian = _jacobian(model, parameters, x) * root[:, None]
        normal = jacobian.mT @ (jacobian * share[..., None])
        towards = jacobian.mT @ (residual * share)[..., None]
        diagonal = torch.diagonal(normal, dim1=-2, dim2=-1)
        damped = normal + torch.diag_embed(diagonal * damping + 1e-18 * diagonal.amax(-1, keepdim=True) + 1e-30)
        step = torch.linalg.solve(damped, towards)[..., 0]
        tried = scaled(parameters + step)
        before, after = _loss(residual, scale), _loss(tried, scale)
        better = after < before
        parameters = torch.where(better[:, None], parameters + step, parameters)
        residual = torch.where(better[:, None], tried, residual)
        damping = torch.where(better[:, None], damping / 5, damping * 8).clamp(1e-12, 1e12)
        stalled = torch.where(better, before - after <= FLAT * before, damping[:, 0] > STUCK)
        if bool(stalled.all()):
            break
    return parameters.detach()


def _jacobian(model: Prediction, parameters: Tensor, x: Tensor) -> Tensor:
    """``(B, K, P)``: the gradient of a gradient that is linear in a dummy gives columns, not rows."""
    at = parameters.detach().requires_grad_()
    found = model(at, x)
    dummy = torch.zeros_like(found, requires_grad=True)
    (rows,) = torch.autograd.grad(found, at, dummy, create_graph=True)
    columns = [torch.autograd.grad(rows[:, place].sum(), dummy, retain_graph=True)[0] for place in range(at.shape[-1])]
    return torch.stack(columns, -1).detach()


def _loss(residual: Tensor, scale: Tensor) -> Tensor:
    size = residual.abs() / scale
    lost = torch.where(size <= HUBER, size.square() / 2, HUBER * (size - HUBER / 2)).sum(-1)
    return lost.nan_to_num(float("inf"))
