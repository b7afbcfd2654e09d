"""Noise that is a function of position: the same point has the same value in every view, batch and process.

No random generator is involved: integer cell coordinates are hashed, so a surface keeps its grain when the camera
moves and a crop of an image equals the image of the cropped camera. The field repeats after 65536 cells.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

__all__ = ["cell_noise", "value_noise"]

# Large primes of Teschner et al. 2003, "Optimized spatial hashing for collision detection of deformable objects".
HASH_PRIMES = (73856093, 19349663, 83492791)
TABLE_SIZE = 1 << 16
# 32-bit finaliser (multiply and xor-shift twice); any odd multiplier with spread-out bits serves.
HASH_MULTIPLIER = 0x45D9F3B
MASK_32 = 0xFFFFFFFF


@lru_cache(maxsize=64)
def _table(seed: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Uniform numbers in [0, 1), ``(65536,)``, a fixed function of the seed."""
    h = (torch.arange(TABLE_SIZE, device=device) + seed * TABLE_SIZE) & MASK_32
    for _ in range(2):
        h = ((h ^ (h >> 16)) * HASH_MULTIPLIER) & MASK_32
    # 24 bits: exact in float32, and never rounded up to 1.
    return ((h ^ (h >> 16)) >> 8).to(dtype) / 2**24


def _cells(scaled: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Hash terms of the cells' x, y and z, ``(...)`` each."""
    x, y, z = scaled.long().unbind(-1)
    return x * HASH_PRIMES[0], y * HASH_PRIMES[1], z * HASH_PRIMES[2]


def cell_noise(point_m: Tensor, cell_m: float, seed: int = 0) -> Tensor:
    """One uniform number in [0, 1) per cube of the given edge.

    Args:
        point_m: positions, metres, ``(..., 3)``.
        cell_m: edge of a cube, metres.
        seed: another integer gives an independent field.

    Returns:
        ``(...)`` in the dtype of ``point_m``.

    Example:
        >>> same_cell = torch.tensor([[0.1, 0.1, 0.1], [0.9, 0.2, 0.6]])
        >>> cell_noise(same_cell, cell_m=1.0).unique().numel()
        1
    """
    x, y, z = _cells(torch.floor(point_m / cell_m))
    return _table(seed, point_m.dtype, point_m.device)[(x ^ y ^ z) & (TABLE_SIZE - 1)]


def value_noise(point_m: Tensor, cell_m: float, seed: int = 0) -> Tensor:
    """Smooth noise in [0, 1): hashed values at the corners of a grid, blended with ``s = f^2 (3 - 2 f)``.

    Args:
        point_m: positions, metres, ``(..., 3)``.
        cell_m: grid spacing, about half the wavelength of the coarsest ripple, metres.
        seed: another integer gives an independent field.

    Returns:
        ``(...)`` in the dtype of ``point_m``; mean 0.5.

    Example:
        >>> float(value_noise(torch.tensor([0.3, 2.0, 1.5]), cell_m=0.5)) < 1.0
        True
    """
    scaled = point_m / cell_m
    corner = torch.floor(scaled)
    fraction = scaled - corner
    weight_x, weight_y, weight_z = (fraction * fraction * (3 - 2 * fraction)).unbind(-1)
    x0, y0, z0 = _cells(corner)
    x1, y1, z1 = x0 + HASH_PRIMES[0], y0 + HASH_PRIMES[1], z0 + HASH_PRIMES[2]
    table = _table(seed, point_m.dtype, point_m.device)

    def along_x(row: Tensor) -> Tensor:
        low, high = table[(x0 ^ row) & (TABLE_SIZE - 1)], table[(x1 ^ row) & (TABLE_SIZE - 1)]
        return torch.lerp(low, high, weight_x)

    near = torch.lerp(along_x(y0 ^ z0), along_x(y1 ^ z0), weight_y)
    far = torch.lerp(along_x(y0 ^ z1), along_x(y1 ^ z1), weight_y)
    return torch.lerp(near, far, weight_z)
