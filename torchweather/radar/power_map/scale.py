"""Scale of a radar power map: from stored numbers to dB and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_finite, check_one_of, check_positive

__all__ = ["SCALE_KINDS", "PowerScale"]

SCALE_KINDS = ("linear", "amplitude", "complex", "db", "db_steps")
LEVELS = 256  # of one byte
NAVTECH_STEP_DB = 0.5
DB = math.log(10.0) / 10.0
JOIN = 0.9  # share of the noise below the level from which the steps of the scale count again
LEAST_CELLS = 200  # of noise, for its law
FINEST_DB = 1e-3  # between two levels, so that the order of levels stays


@dataclass(frozen=True)
class PowerScale:
    """Meaning of the numbers of a map.

    Args:
        kind: ``linear`` (power), ``amplitude`` (its square root), ``complex`` (complex amplitude), ``db``, or
            ``db_steps`` (dB in the 256 levels of a byte).
        edges_db: of ``db_steps``: the 255 levels of power, dB, that separate neighbouring bytes; rising. All that
            is below the first is byte 0. ``None`` for the other kinds.

    Example:
        >>> scale = PowerScale.steps(0.5)
        >>> scale.decibels(torch.tensor([0, 1, 255], dtype=torch.uint8))
        tensor([  0.0000,   0.5000, 127.5000])
    """

    kind: str
    edges_db: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_arguments("PowerScale(kind: str, edges_db: Sequence | None)", self.kind, self.edges_db)
        check_one_of("kind", self.kind, SCALE_KINDS, owner=self)
        if (self.edges_db is not None) != (self.kind == "db_steps"):
            raise InputValueError(
                f"PowerScale: edges_db belong to kind='db_steps'; got kind={self.kind!r} "
                f"{'with' if self.edges_db is not None else 'without'} them. PowerScale.steps(step_db) makes them."
            )
        if self.edges_db is None:
            return
        edges = tuple(float(edge) for edge in self.edges_db)
        if len(edges) != LEVELS - 1 or any(high <= low for low, high in pairwise(edges)):
            raise InputValueError(f"PowerScale: edges_db must be {LEVELS - 1} rising levels in dB; got {len(edges)}.")
        check_finite("edges_db", torch.tensor(edges), unit="dB", owner=self)
        object.__setattr__(self, "edges_db", edges)

    # ---- makers --------------------------------------------------------------------------------------------------

    @classmethod
    def steps(cls, step_db: float = NAVTECH_STEP_DB, bottom_db: float = 0.0) -> PowerScale:
        """A byte b is ``bottom_db + b step_db``.

        Args:
            step_db: of one level, above 0. Radars of Navtech store half dB (from memory of the maker's protocol,
                unverified; the beam's flanks in RADIATE give 0.35 to 0.57 dB).
            bottom_db: power of byte 0, dB. Weaker power has byte 0 as well.
        """
        check_positive("step_db", step_db, unit="dB", owner=cls)
        check_finite("bottom_db", bottom_db, unit="dB", owner=cls)
        return cls("db_steps", tuple(bottom_db + (byte + 0.5) * step_db for byte in range(LEVELS - 1)))

    @classmethod
    def from_noise(cls, noise: Tensor, step_db: float = NAVTECH_STEP_DB) -> PowerScale:
        r"""Scale of bytes by which a recording's receiver noise has exponential power of mean 0 dB.

        Noise of one look has an exponential law, so that the share F of noise cells at or below byte b puts its upper
        edge at ``-ln(1 - F)`` times the mean noise. That holds up to F = 0.9 (3.6 dB); above, and below the weakest
        noise, ``step_db`` counts.

        Args:
            noise: bytes of cells that hold noise alone, any shape, 200 or more; ``quiet_cells`` finds some.
            step_db: of one level away from the noise.

        Raises:
            ValueError: too few cells, or noise that is (nearly) all in one level.
        """
        check_positive("step_db", step_db, unit="dB", owner=cls)
        if noise.dtype != torch.uint8 or noise.numel() < LEAST_CELLS:
            raise InputValueError(
                f"PowerScale.from_noise: expected {LEAST_CELLS} bytes of noise or more; got {noise.numel()} of "
                f"{noise.dtype}. PowerScale.steps(step_db) needs none."
            )
        count = np.bincount(noise.flatten().numpy(force=True), minlength=LEVELS)
        below = np.cumsum(count)[:-1] / count.sum()
        known = np.flatnonzero((below > 0) & (below <= JOIN))
        if len(known) < 3:
            raise InputValueError(
                "PowerScale.from_noise: expected noise over several levels; got "
                f"{int((count > 0).sum())} levels. The floor was cut off: give PowerScale.steps(step_db)."
            )
        return cls("db_steps", tuple(_joined(below, known, float(step_db)).tolist()))

    # ---- both ways -----------------------------------------------------------------------------------------------

    def decibels(self, values: Tensor) -> Tensor:
        """Power of stored numbers, dB; of bytes the middle of each level, of no power minus infinity.

        Args:
            values: any shape; ``uint8`` for ``db_steps``, complex for ``complex``, else real.

        Returns:
            float32, or float64 of float64.
        """
        self.check(values)
        if self.kind == "db_steps":
            return self._middles(values.device)[values.long()]
        real = values if values.dtype in (torch.float32, torch.float64, torch.complex64, torch.complex128) else None
        number = values.float() if real is None else real
        if self.kind == "db":
            return number
        if self.kind == "linear":
            return 10.0 * number.log10()
        return 20.0 * number.abs().log10()

    def bounds_db(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Edges of the level of each byte, dB, from minus infinity to one step above the last level."""
        self.check(values)
        edges = torch.tensor(self.edges_db, device=values.device)
        top = 2.0 * edges[-1] - edges[-2]
        low = torch.cat([edges.new_full((1,), -math.inf), edges])
        high = torch.cat([edges, top[None]])
        level = values.long()
        return low[level], high[level]

    def stored(self, decibels: Tensor, like: Tensor) -> Tensor:
        """Numbers of a map for powers in dB, in the dtype of ``like``; bytes end at 0 and 255, whole numbers round."""
        if self.kind == "db_steps":
            edges = torch.tensor(self.edges_db, device=decibels.device, dtype=decibels.dtype)
            return torch.bucketize(decibels.contiguous(), edges).to(torch.uint8)
        found = decibels
        if self.kind in ("linear", "amplitude"):
            found = torch.exp((DB if self.kind == "linear" else 0.5 * DB) * decibels)
        if self.kind == "complex":
            raise InputValueError("PowerScale: a complex map has a phase, which dB do not give.")
        if like.is_floating_point():
            return found.to(like.dtype)
        limits = torch.iinfo(like.dtype)
        return found.round().clamp(limits.min, limits.max).to(like.dtype)

    def check(self, values: Tensor) -> None:
        """Refuse numbers that the scale cannot hold."""
        if self.kind == "db_steps" and values.dtype != torch.uint8:
            raise InputTypeError(f"PowerScale: kind='db_steps' is of bytes (uint8); got {values.dtype}.")
        if (self.kind == "complex") != values.is_complex():
            raise InputTypeError(f"PowerScale: kind={self.kind!r} does not fit numbers of {values.dtype}.")
        if self.kind in ("linear", "amplitude") and values.numel() and bool((values < 0).any()):
            raise InputValueError(
                f"PowerScale: kind={self.kind!r} is of 0 or more; got {float(values.min()):g}. A map in dB has "
                "kind='db'."
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain values that ``from_dict`` takes."""
        return {"kind": self.kind, "edges_db": None if self.edges_db is None else list(self.edges_db)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PowerScale:
        """The inverse of ``to_dict``."""
        check_arguments("PowerScale.from_dict(values: Mapping[str])", values)
        check_arguments(
            "PowerScale(kind: str, edges_db: Sequence[float] | None)", values.get("kind"), values.get("edges_db")
        )
        edges: Sequence[float] | None = values.get("edges_db")
        return cls(values["kind"], None if edges is None else tuple(edges))

    def _middles(self, device: torch.device) -> Tensor:
        edges = torch.tensor(self.edges_db, device=device, dtype=torch.float64)
        ends = [2.0 * edges[:1] - edges[1:2], edges, 2.0 * edges[-1:] - edges[-2:-1]]
        every = torch.cat(ends)
        return (0.5 * (every[1:] + every[:-1])).float()


def _joined(below: npt.NDArray[np.float64], known: npt.NDArray[np.intp], step_db: float) -> npt.NDArray[np.float64]:
    """Edges from the noise where its share is known, steps beyond."""
    first, last = int(known[0]), int(known[-1])
    edges = np.empty(LEVELS - 1)
    inside = np.maximum.accumulate(below[first : last + 1])
    edges[first : last + 1] = 10.0 * np.log10(-np.log1p(-inside))
    # Levels that no noise cell had: their edges lie a hair apart, in order.
    for place in range(first + 1, last + 1):
        edges[place] = max(edges[place], edges[place - 1] + FINEST_DB)
    edges[last + 1 :] = edges[last] + step_db * np.arange(1, LEVELS - 1 - last)
    edges[:first] = edges[first] - step_db * np.arange(first, 0, -1)
    return edges
