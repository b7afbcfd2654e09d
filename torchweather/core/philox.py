"""Constants of the counter-based generator Philox 4 x 64 of numpy.

References:
    Salmon et al. 2011, Parallel random numbers: as easy as 1, 2, 3.
"""

from __future__ import annotations

__all__ = ["MULTIPLIERS", "NORMALS_A_BLOCK", "ROUNDS", "WEYL"]

ROUNDS = 10
MULTIPLIERS = (0xD2E7470EE14C6C93, 0xCA5A826395121157)
WEYL = (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B)
NORMALS_A_BLOCK = 16  # tabulated normals: 4 words of 64 bits of a counter, 16 bits a normal
