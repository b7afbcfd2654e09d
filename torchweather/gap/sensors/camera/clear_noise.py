"""Noise of a camera's clear frames, as far as it reaches the frames in weather.

The model under test starts from the mean of the clear frames. Of the noise of that mean the share t of the light passes
that air and particles leave of the scene's; a measured frame has noise of its own, by the light of now. So in dense fog
few clear frames are hardly an error, while in clear air they are one as large as that of as few measured frames.

With K clear frames, d the departure of one from their mean, and a of ``CameraScene.with_noise``, the simulated frame of
that one moves the logarithm over the mean of the others, in the unit of the signal, by

    d (a K - t + s) / (K - 1)

where s is the signal over that of the clear scene. Of the regressions on the clear scene, which the fog is in, s is t.
In clear air it is ``d K / (K - 1)``.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.inference.simulated_distribution import ClearNoise
from torchweather.gap.sensors.camera.scene import (
    CameraScene,
    block_of_colours,
    noise_of_difference,
    place_in,
)
from torchweather.gap.sensors.camera.sums import CameraSums

__all__ = ["camera_clear_noise"]

Floats = NDArray[np.float64]


def camera_clear_noise(
    scene: CameraScene, sums: CameraSums, signal: Tensor, transmission: Tensor | None, covered: Tensor | None
) -> ClearNoise:
    """Of the statistics that are means over the elements of a frame, in one weather.

    Args:
        scene: with its clear frames.
        sums: of the condition.
        signal: ``(1, 1, H, W)`` a simulated frame without noise.
        transmission: share of the clear frame's signal that the medium leaves, of the same shape; ``None`` is 1.
        covered: share of the exposure in which particles hide the scene, of the same shape; ``None`` is 0.
    """
    layout, clear = sums.layout, len(scene.clear)
    share, covered = (
        torch.full_like(signal, missing) if one is None else one
        for one, missing in ((transmission, 1.0), (covered, 0.0))
    )
    before, now, left, lost = (
        block_of_colours(one.double(), sums.pattern)[0]
        for one in (scene.reference[-1:], signal, share, share * covered)
    )  # (C, B) each
    constant, growing = scene.noise_variance
    of_clear = constant + growing * before
    grown = (constant + growing * now) / of_clear.clamp_min(1e-12)
    added = noise_of_difference(grown, left, lost, 1.0 / (clear - 1))
    seen, level = left - lost, now / before.clamp_min(1e-12)
    moved = {
        "log": (added * clear - seen + level).square() / (clear - 1) ** 2,
        "regression": (added * clear + lost).square() / (clear - 1) ** 2,
    }
    weights = {"log": of_clear / now.clamp_min(1e-3).square(), "regression": of_clear}
    own, passed = np.full(layout.size, ((clear - 1) / clear) ** 2), np.ones(layout.size)
    for group, part in zip(layout.groups, layout.slices, strict=True):
        kind = "log" if group.statistic.startswith("log_ratio_") else "regression"
        if not group.is_average_of(group.statistic) or group.statistic in layout.about_clear_mean:
            continue
        colour = next((number for number, one in enumerate(sums.colours) if group.statistic.endswith(f"_{one}")), None)
        colour = sums.green if colour is None else colour
        bins = sums.axes[group.axis][0] if kind == "log" else place_in(scene.block_depth_m, group.edges)
        weight = weights[kind][colour]
        of_frame, of_simulated, of_mean = (
            _summed(bins, weight * one, group.bins)
            for one in (grown[colour], moved[kind][colour], seen[colour].square())
        )
        some = (of_simulated > 0.0) & (of_frame > 0.0)
        own[part] = np.where(some, of_frame / np.where(some, of_simulated, 1.0), own[part])
        passed[part] = np.where(some, of_mean / np.where(some, of_frame, 1.0), 1.0)
    return ClearNoise(own, passed)


def _summed(bins: Tensor, values: Tensor, number: int) -> Floats:
    """Values of blocks ``(B,)`` summed in their bins."""
    inside = (bins >= 0).numpy()
    return np.asarray(np.bincount(bins.numpy()[inside], values.numpy()[inside], number), dtype=np.float64)
