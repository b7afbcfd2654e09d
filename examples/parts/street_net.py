"""A small net that gives each pixel of a picture its class, and its score."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor, nn

STRIDE = 4  # pixels to a cell of the net's answer


class StreetNet(nn.Module):
    """Convolutions at a quarter of the picture's size; dilated ones see far."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = [(3, 16, 2, 1), (16, 32, 2, 1), (32, 48, 1, 1), (48, 48, 1, 2), (48, 48, 1, 4), (48, 48, 1, 8)]
        for inside, outside, stride, dilation in channels:
            layers += [nn.Conv2d(inside, outside, 3, stride, dilation, dilation), nn.GroupNorm(8, outside), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Conv2d(48, classes, 1))

    def forward(self, pictures: Tensor) -> Tensor:
        """``(B, 3, H, W)`` uint8 to logits ``(B, classes, H / 4, W / 4)``."""
        return self.layers(pictures / 255 - 0.5)


def trained(
    batches: Iterable[tuple[Tensor, Tensor]], steps: int, seed: int, classes: int, device: str = "cpu"
) -> StreetNet:
    """A net that has learned from so many batches of pictures ``(B, 3, H, W)`` and classes ``(B, H, W)``."""
    torch.manual_seed(seed)
    net = StreetNet(classes).to(device)
    optimiser = torch.optim.AdamW(net.parameters(), lr=4e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 8e-3, total_steps=steps)
    for pictures, wanted in batches:
        if torch.rand(()) < 0.5:
            pictures, wanted = pictures.flip(-1), wanted.flip(-1)
        small = wanted[:, STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE]
        loss = nn.functional.cross_entropy(net(pictures.to(device)), small.to(device))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return net.eval()


@torch.no_grad()
def mean_iou(net: StreetNet, pictures: Tensor, classes: Tensor) -> float:
    """Mean intersection over union of the classes that occur, over all pixels of all pictures."""
    device = next(net.parameters()).device
    small = torch.cat([net(one[None].to(device)).cpu() for one in pictures])
    found = nn.functional.interpolate(small, classes.shape[-2:], mode="bilinear").argmax(1)
    shares = []
    for one in range(small.shape[1]):
        said, true = found == one, classes == one
        if true.any():
            shares.append(float((said & true).sum() / (said | true).sum()))
    return float(np.mean(shares))
