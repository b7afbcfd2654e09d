"""Constants of the counter-based generator Philox 4 x 64 (Salmon et al. 2011)."""

__all__ = ["MULTIPLIERS", "ROUNDS", "WEYL"]

ROUNDS = 10
MULTIPLIERS = (0xD2E7470EE14C6C93, 0xCA5A826395121157)
WEYL = (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B)
