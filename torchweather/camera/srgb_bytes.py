"""sRGB images of 8 bits to linear light and back by tables, in bands that stay in the cache.

A power costs ten times a look-up, and a fresh tensor of a whole image more than both. The tables give what
``srgb_decode`` gives for each of the 256 levels, and the level whose range holds a linear value.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.tone import srgb_decode
from torchweather.core.compiled import uses_compiled

__all__ = ["byte_limits", "bytes_of_light", "light_of_bytes"]

LEVELS = 256
# Ranges of equal width, each of which holds at most one limit between two levels: those are 3.0e-4 apart or more.
RANGES = 4096
SAMPLES_AT_ONCE = 1 << 16  # whose arrays stay in the cache of a processor
SAMPLES_ON_DEVICE = 1 << 26


@lru_cache(maxsize=8)
def _light(device: torch.device) -> Tensor:
    return srgb_decode(torch.arange(LEVELS, dtype=torch.float32) / 255.0).to(device)


@lru_cache(maxsize=1)
def _light_of_pairs() -> Tensor:
    """Linear light of two bytes side by side, both in one number of 64 bits; by the number that they are in memory."""
    pairs = torch.arange(LEVELS**2).to(torch.uint16).view(torch.uint8)
    return _light(torch.device("cpu")).index_select(0, pairs.int()).view(torch.float64)


@lru_cache(maxsize=8)
def byte_limits(device: torch.device) -> tuple[Tensor, Tensor]:
    """Of each range: the level at its lower end, and where the next level begins (infinity: beyond the range)."""
    shown = (np.arange(1, LEVELS) - 0.5) / 255.0
    begins = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    begins = _rounded_up(begins)
    lower = (np.arange(RANGES + 1) / RANGES).astype(np.float32)
    level = np.searchsorted(begins, lower, side="right")
    following = np.append(begins, np.float32(np.inf))[level]
    return torch.from_numpy(level.astype(np.uint8)).to(device), torch.from_numpy(following).to(device)


@lru_cache(maxsize=8)
def _rising_level(device: torch.device) -> Tensor:
    """Of each range: the level at its lower end, and a whole one more less the share of the range before the next.

    This plus the share of the range below a value, truncated, is the value's level. All three are exact in float32:
    where limits are dense, numbers are small.
    """
    level, begins = (table.cpu().double() for table in byte_limits(torch.device("cpu")))
    before = begins * RANGES - torch.arange(RANGES + 1)
    return torch.where(before < 1, level + 1 - before, level).float().to(device)


def _rounded_up(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """The nearest numbers of float32 that are not below."""
    near = values.astype(np.float32)
    return np.where(near < values, np.nextafter(near, np.float32(np.inf)), near)


def _compiled(image: Tensor) -> bool:
    """True where numba looks up the same numbers, faster."""
    return image.device.type == "cpu" and not torch.compiler.is_compiling() and uses_compiled()


def _portions(flat: Tensor) -> list[slice]:
    size = SAMPLES_AT_ONCE if flat.device.type == "cpu" else SAMPLES_ON_DEVICE
    return [slice(start, start + size) for start in range(0, flat.numel(), size)]


def light_of_bytes(image: Tensor) -> Tensor:
    """Linear light of sRGB levels, float32.

    Args:
        image: uint8, any shape.
    """
    table = _light(image.device)
    out = torch.empty(image.shape, dtype=torch.float32, device=image.device)
    flat, found = image.reshape(-1), out.view(-1)
    if _compiled(image):
        from torchweather.camera.compiled_bytes import look_up

        look_up(found.numpy(), flat.numpy(), table.numpy())
        return out
    if image.device.type == "cpu":  # half of the look-ups
        even = flat.numel() // 2 * 2
        pairs, found_pairs = flat[:even].view(torch.uint16), found[:even].view(torch.float64)
        for some in _portions(pairs):
            torch.index_select(_light_of_pairs(), 0, pairs[some].int(), out=found_pairs[some])
        flat, found = flat[even:], found[even:]
    for some in _portions(flat):
        torch.index_select(table, 0, flat[some].int(), out=found[some])
    return out


def bytes_of_light(linear: Tensor) -> Tensor:
    """sRGB levels of linear light, uint8: the nearest, clipped to 0..255.

    Args:
        linear: float, any shape, saturation 1.
    """
    out = torch.empty(linear.shape, dtype=torch.uint8, device=linear.device)
    flat, found = linear.detach().reshape(-1), out.view(-1)
    if linear.dtype == torch.float32 and _compiled(linear):
        from torchweather.camera.compiled_bytes import find_levels

        level, begins = byte_limits(linear.device)
        find_levels(found.numpy(), flat.numpy(), level.numpy(), begins.numpy())
        return out
    if linear.dtype != torch.float64:
        flat = flat.float()
    rising, portions = _rising_level(linear.device).to(flat.dtype), _portions(flat)
    # The same arrays for each portion: fresh ones leave the cache.
    size = flat[portions[0]].numel() if portions else 0
    place, whole = flat.new_empty(size), torch.empty(size, dtype=torch.int32, device=flat.device)
    level = flat.new_empty(size)
    for part in portions:
        some = flat[part]
        place, whole, level = (array[: some.numel()] for array in (place, whole, level))
        torch.mul(some, RANGES, out=place).clamp_(0.0, RANGES)
        torch.index_select(rising, 0, whole.copy_(place), out=level)
        # By whole numbers: a third of the time from float to bytes.
        found[part] = whole.copy_(level.add_(place.frac_()))
    return out
