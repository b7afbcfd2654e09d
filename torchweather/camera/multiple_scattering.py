"""Light that dense fog scatters onward to the camera: what arrives blurred, beside what arrives straight.

Each surface lends the pixels around it the share of its light that the fog scatters by small angles
(``torchweather.atmosphere.forward_scattering``); that share takes the place of airlight. A pixel's own light and the
light of its neighbours lie at different depths, so both are sorted by optical depth: from a surface at ``tau_q`` a
pixel at ``tau_p`` gets ``w(min(tau_p, tau_q)) exp(-max(tau_q - tau_p, 0))``, for light from farther away reaches the
pixel's depth weakened, and the surface of a near neighbour ends the path on which light can be scattered.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate, pad

from torchweather.atmosphere.forward_scattering import WIDTHS_RAD, ForwardScattering
from torchweather.atmosphere.weather import REHEARSE, REHEARSE_MOR_M, Fog
from torchweather.camera.mosaic_blur import gaussian_blur, phases, spacing_px, whole
from torchweather.camera.state import CameraState

__all__ = ["forward_scattered", "kernel_weights"]

# Optical depths between which a share is interpolated.
NODES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.95, 1.25, 1.6, 2.0, 2.5, 3.1, 3.8, 4.6, 5.6, 7.0, 9.0, 12.0, 20.0, 80.0)
SMALLEST_SAMPLES = 0.75  # standard deviation of a Gaussian in samples of its level of the pyramid, at least
# The pyramid blurs too: its means over blocks and its linear interpolation have this variance, samples squared.
PYRAMID_VARIANCE = 0.305
MOR_DIGITS = 2  # of the visibility whose droplet sizes stand for a fog's: the shape changes slowly


def kernel_weights(fog: Fog, wavelength_nm: float, mor_m: Tensor) -> Tensor:
    """Share of light that arrives blurred, ``(B, 8 widths, M nodes)``.

    Args:
        fog: whose droplet sizes scatter.
        wavelength_nm: of the colour that stands for all.
        mor_m: ``(B,)`` visibility, metres; where it is infinite the shares are 0.
    """
    return torch.stack([_weights(fog, wavelength_nm, _rounded(mor)) for mor in mor_m.reshape(-1).tolist()])


def _rounded(mor_m: float) -> float:
    return float(f"{mor_m:.{MOR_DIGITS}g}") if math.isfinite(mor_m) else math.inf


@lru_cache(maxsize=64)
def _weights(fog: Fog, wavelength_nm: float, mor_m: float) -> Tensor:
    nodes = torch.tensor(NODES, dtype=torch.float64)
    if math.isinf(mor_m):
        return torch.zeros(len(WIDTHS_RAD), len(NODES), dtype=torch.float64)
    if fog.size_distribution == REHEARSE:
        mor_m = min(max(mor_m, REHEARSE_MOR_M[0]), REHEARSE_MOR_M[-1])
    kernel = ForwardScattering.of_fog(fog.distribution(mor_m), wavelength_nm, fog.temperature_c)
    return kernel.weights(nodes).T


def forward_scattered(state: CameraState, transmission: Tensor, airlight: Tensor, weights: Tensor) -> Tensor:
    """Signal to add to a frame in fog: light scattered onward less the airlight whose place it takes, ``(B, C, H, W)``.

    Args:
        state: the frame before the fog.
        transmission: ``(B, C, H, W)`` of the fog in front of each pixel.
        airlight: ``(B, C, H, W)`` signal of endless fog at each pixel.
        weights: of `kernel_weights`.
    """
    spacing, signal = spacing_px(state), state.image.signal
    planes, height, width = phases(signal, spacing), *signal.shape[-2:]
    through = phases(transmission, spacing).mean(1, keepdim=True)
    depth = -torch.log(through.clamp_min(math.exp(-NODES[-1])))
    focal_px = float(state.scene.intrinsics[0, 0]) / spacing
    shares = _exchange(weights.to(signal))
    # No coarser than leaves a few samples of the frame.
    coarsest = max(0, math.floor(math.log2(min(planes.shape[-2:]) / 4)))
    ratios = (max(width_rad * focal_px / SMALLEST_SAMPLES, 1.0) for width_rad in WIDTHS_RAD)
    levels = [min(math.floor(math.log2(ratio)), coarsest) for ratio in ratios]
    pyramid = _sorted_by_depth(planes, depth, levels)
    found = torch.zeros_like(pyramid[max(levels)])
    for level in range(max(levels), min(levels) - 1, -1):
        sources = pyramid[level]
        if level < max(levels):
            finer = interpolate(found.flatten(1, 2), scale_factor=2.0, mode="bilinear", align_corners=False)
            found = finer.view(*found.shape[:3], *finer.shape[-2:])[..., : sources.shape[-2], : sources.shape[-1]]
        for number, own in enumerate(levels):
            if own == level:
                spread = WIDTHS_RAD[number] * focal_px / 2.0**level
                variance = max(spread**2 - (PYRAMID_VARIANCE if level else 0.0), 1e-3)
                blurred = gaussian_blur(sources.flatten(1, 2), variance, 1).view_as(sources)
                found = found + torch.einsum("blm,bmchw->blchw", shares[:, number], blurred)
    seen = _at_depth(found, depth, 2 ** min(levels))
    light, place = seen[:, :-1], seen[:, -1:]
    added = whole(light - place * phases(airlight, spacing), spacing)
    return added[..., :height, :width]


def _exchange(weights: Tensor) -> Tensor:
    """Share of the light of a surface at node m that reaches a pixel at node l, ``(B, K, L, M)`` of ``(B, K, M)``.

    A surface at the next node counts as one at the pixel's own: a wall between two nodes then lends its own pixels
    what the theory says, ``w(tau)``.
    """
    number = torch.arange(weights.shape[-1], device=weights.device)
    row, nearer = number[:, None], torch.minimum(number[:, None], number)
    beside = (number - row).abs() == 1
    node = weights.new_tensor(NODES)
    weakened = torch.exp(-(node - node[(row + 1).clamp_max(len(NODES) - 1)]).clamp_min(0.0))
    between = 0.5 * (weights[..., :, None] + weights[..., None, :])
    return torch.where(beside, between, weights[..., nearer] * weakened)


def _place(depth: Tensor) -> Tensor:
    """Place of an optical depth among the nodes, 0 to their number less 1."""
    node = depth.new_tensor(NODES)
    cell = (torch.bucketize(depth.detach(), node, right=True) - 1).clamp(0, len(NODES) - 2)
    return cell + ((depth - node[cell]) / (node[cell + 1] - node[cell])).clamp(0.0, 1.0)


def _sorted_by_depth(planes: Tensor, depth: Tensor, levels: list[int]) -> dict[int, Tensor]:
    """Means over blocks of each level, ``(B, M, P + 1, h, w)``: the planes, and 1, where the depth is at each node."""
    finest = min(levels)
    before = max(finest - 1, 0)  # a block of 2 x 2 of these has pixels of several depths where an edge crosses it
    every = _pooled(torch.cat([planes, torch.ones_like(depth)], 1), before)
    place = _place(depth[..., 2**before // 2 :: 2**before, 2**before // 2 :: 2**before])
    place = pad(place, (0, every.shape[-1] - place.shape[-1], 0, every.shape[-2] - place.shape[-2]), "replicate")
    hats = ((1.0 - (place - number).abs()).clamp_min(0.0) for number in range(len(NODES)))
    pyramid = {finest: torch.stack([_pooled(every * hat, finest - before) for hat in hats], 1)}
    for level in range(finest + 1, max(levels) + 1):
        finer = pyramid[level - 1]
        pooled = _pooled(finer.flatten(1, 2), 1)
        pyramid[level] = pooled.view(*finer.shape[:3], *pooled.shape[-2:])
    return pyramid


def _pooled(image: Tensor, level: int) -> Tensor:
    """Means over blocks of ``2^level`` pixels; at the end the frame goes on as it ends."""
    if not level:
        return image
    step = 2**level
    height, width = image.shape[-2:]
    return avg_pool2d(pad(image, (0, -width % step, 0, -height % step), "replicate"), step)


def _at_depth(found: Tensor, depth: Tensor, step: int) -> Tensor:
    """Each pixel's value of ``(B, L, P + 1, h, w)``, linear in its place among the nodes and between samples."""
    batch, _, height, width = depth.shape
    rows, columns = found.shape[-2:]
    down = (torch.arange(height, device=depth.device).to(depth) + 0.5) * (2.0 / (step * rows)) - 1.0
    across = (torch.arange(width, device=depth.device).to(depth) + 0.5) * (2.0 / (step * columns)) - 1.0
    level = (_place(depth)[:, 0] + 0.5) * (2.0 / len(NODES)) - 1.0
    grid = torch.stack([across.expand(batch, height, width), down[:, None].expand(batch, height, width), level], -1)
    volume = found.transpose(1, 2)  # (B, P + 1, L, h, w)
    sampled: Tensor = grid_sample(volume, grid[:, None], mode="bilinear", padding_mode="border", align_corners=False)
    return sampled[:, :, 0]
