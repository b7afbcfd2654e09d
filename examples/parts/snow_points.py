"""Snow against objects in a scan: average precision of a net's scores, and a rule that needs no training."""

from __future__ import annotations

import math
from typing import Any

import torch
from parts.lidar_segmenter import COLUMNS, NONE, WEATHER, picture_of
from torch import Tensor


def average_precision(score: Tensor, is_snow: Tensor) -> float:
    """Area under precision over recall: the mean precision at each flake, the surest first."""
    hits = is_snow[score.argsort(descending=True, stable=True)].double()
    precision = hits.cumsum(0) / torch.arange(1, len(hits) + 1)
    return float((precision * hits).sum() / hits.sum().clamp_min(1))


@torch.no_grad()
def of_net(net: Any, clouds: Tensor, classes: Tensor) -> float:
    """Of a net's probability of weather, over all returns."""
    device = next(net.parameters()).device
    score = net(picture_of(clouds).to(device)).softmax(1)[:, WEATHER].flatten().cpu()
    there = classes.flatten() != NONE
    return average_precision(score[there], classes.flatten()[there] == WEATHER)


def of_rule(clouds: Tensor, classes: Tensor) -> float:
    """Dynamic radius outlier removal (Charron et al. 2018) with the intensity: few neighbours, and dim, is snow.

    The radius follows the distance between beams at the point's range, 3 times their angle; at least 0.04 m.
    """
    scores = []
    for points in clouds:
        radius_m = (3.0 * 2.0 * math.pi / COLUMNS * points[:, :2].norm(dim=1)).clamp_min(0.04)
        near = torch.cat(
            [
                (torch.cdist(some[:, :3], points[:, :3]) < one[:, None]).sum(1)
                for some, one in zip(points.split(1024), radius_m.split(1024), strict=True)
            ]
        )
        scores.append(-torch.log(near.float()) - points[:, 3] / 50)
    there = classes.flatten() != NONE
    return average_precision(torch.cat(scores)[there], classes.flatten()[there] == WEATHER)
