"""The image pairs of the oracle, rebuilt and checked against their hashes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tests.oracles import iqa_inputs

__all__ = ["Case", "cases"]


@dataclass(frozen=True)
class Case:
    """One pair and its score. The images ``(C, H, W)`` in [0, 1] are made when they are asked for."""

    name: str
    pair: dict[str, Any]
    dtype: torch.dtype
    score: float

    @property
    def distorted(self) -> Tensor:
        """The worse image, checked against the oracle's hash."""
        worse = self._images[0]
        assert iqa_inputs.sha(worse) == self.pair["sha256_distorted"]
        return _tensor(worse, self.dtype)

    @property
    def reference(self) -> Tensor:
        """The clear image."""
        return _tensor(self._images[1], self.dtype)

    @property
    def _images(self) -> tuple[np.ndarray, np.ndarray]:
        return _images(*(self.pair[key] for key in ("reference", "kind", "level", "colour")))


@lru_cache(maxsize=1)
def _pairs() -> list[dict[str, Any]]:
    path = Path(iqa_inputs.__file__).parent / "iqa_oracles.json"
    pairs: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["pairs"]
    return pairs


@lru_cache(maxsize=64)
def _images(reference: str, kind: str, level: int, colour: bool) -> tuple[np.ndarray, np.ndarray]:
    clear = iqa_inputs.reference(reference)
    worse = iqa_inputs.distort(clear, kind, level)
    return (worse, clear) if colour else (iqa_inputs.grey(worse), iqa_inputs.grey(clear))


def _tensor(image: np.ndarray, dtype: torch.dtype) -> Tensor:
    planes = image[..., None] if image.ndim == 2 else image
    return torch.from_numpy(np.ascontiguousarray(planes.transpose(2, 0, 1))).to(dtype) / 255.0


def cases(score: str, precision: str = "float64") -> Iterator[Case]:
    """Pairs for which the oracle has this score at this precision."""
    for pair in _pairs():
        value = pair.get(precision, {}).get(score)
        if not isinstance(value, float):  # not defined there, or an error of the implementation
            continue
        name = f"{pair['reference']}-{pair['kind']}-{pair['level']}" + ("" if pair["colour"] else "-grey")
        yield Case(name, pair, getattr(torch, precision), value)
