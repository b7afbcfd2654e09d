"""Matched filters: how much of a residual the response to an effect explains, alone and with another.

References:
    GAP.md 3 (5, 6). A matched filter for each distorted simulator: Anau Montel, Alvey & Weniger 2025.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.inference.config import NUMERICS
from torchweather.gap.inference.starting_points import ParameterGrid
from torchweather.gap.inference.systematics import Systematics

__all__ = ["ResponseTemplate", "amplitudes", "delta_chi2", "pair_delta_chi2"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ResponseTemplate:
    """Response to one parameter point of one effect.

    Args:
        grid: it belongs to.
        number: place in the grid.
        values: the parameters.
        response: ``(C P,)`` whitened change of all vectors.
    """

    grid: ParameterGrid
    number: int
    values: Mapping[str, float]
    response: Floats

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.grid.effect.id


def amplitudes(templates: Sequence[ResponseTemplate], left: Floats, nuisance: Systematics) -> tuple[Floats, Floats]:
    """Best amplitude of each template on residuals ``(R, C P)`` after the nuisances, and its squared length."""
    responses = np.stack([template.response for template in templates])
    norm = np.maximum((responses * nuisance(responses)).sum(1), 1e-12)
    found: Floats = np.clip((left @ responses.T) / norm, *NUMERICS.template_amplitudes)
    return found, norm


def delta_chi2(templates: Sequence[ResponseTemplate], left: Floats, nuisance: Systematics) -> Floats:
    """Delta chi-square ``(R, templates)`` of each template, scaled, on residuals ``(R, C P)`` after the nuisances."""
    amplitude, norm = amplitudes(templates, left, nuisance)
    along = left @ np.stack([template.response for template in templates]).T
    found: Floats = 2.0 * amplitude * along - amplitude**2 * norm
    return found


def pair_delta_chi2(templates: Sequence[ResponseTemplate], left: Floats, nuisance: Systematics) -> Floats:
    """Delta chi-square ``(templates, templates)`` of each two together on a residual ``(C P,)``, from one Gram matrix.

    Amplitudes are those of the best point of the square in which both may lie, its edges included.
    """
    responses = np.stack([template.response for template in templates])
    gram = responses @ nuisance(responses).T
    along = responses @ left
    norm = np.maximum(np.diag(gram), 1e-12)
    low, high = NUMERICS.template_amplitudes
    first = np.broadcast_to(along[:, None], gram.shape)
    second = first.T
    determinant = np.maximum(norm[:, None] * norm[None] - gram**2, 1e-9 * norm[:, None] * norm[None])
    inner_1 = (first * norm[None] - second * gram) / determinant
    inner_2 = inner_1.T

    def gain(amplitude_1: Floats, amplitude_2: Floats) -> Floats:
        square = amplitude_1**2 * norm[:, None] + amplitude_2**2 * norm[None] + 2.0 * amplitude_1 * amplitude_2 * gram
        found: Floats = 2.0 * (amplitude_1 * first + amplitude_2 * second) - square
        return found

    inside = (inner_1 >= low) & (inner_1 <= high) & (inner_2 >= low) & (inner_2 <= high)
    best = np.where(inside, gain(inner_1, inner_2), -np.inf)
    for edge in (low, high):
        held = np.full(gram.shape, edge)
        best = np.maximum(best, gain(held, np.clip((second - edge * gram) / norm[None], low, high)))
        best = np.maximum(best, gain(np.clip((first - edge * gram) / norm[:, None], low, high), held))
    return best
