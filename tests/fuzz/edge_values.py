"""Wrong and extreme arguments: of another type, shape or dtype, not finite, negative, huge, empty."""

# ruff: noqa: E501
from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["edge"]

NUMBERS: tuple[Any, ...] = (
    math.nan, math.inf, -math.inf, 0, 0.0, -0.0, -1, -1.0, 1, 2, 3, 0.5, 1e-320, 1e-30, 1e-6, 1e3, 1e6, 1e9, 1e30, 1e300,
    -1e30, 2**31, 2**63, 2**64, 10**30, True, False, 1 + 2j, np.float32(2.5), np.float64("nan"), np.int64(3), np.bool_(True),
    7, 65536, 1.0000001,
)  # fmt: skip
OTHERS: tuple[Callable[[], Any], ...] = (
    lambda: None, lambda: "", lambda: "x", lambda: "nan", lambda: "3", lambda: "rain", lambda: "a" * 1000, lambda: "\x00",
    lambda: "\ud800", lambda: b"x", list, dict, tuple, set, object, lambda: [1, "a"], lambda: [math.nan, 1.0],
    lambda: [[1.0, 2.0], [3.0]], lambda: {"a": 1}, lambda: {1: None}, lambda: (1.0,), lambda: [1.0, 2.0, 3.0], lambda: int,
    lambda: len, lambda: range(3), lambda: iter([1.0]), lambda: Path("missing/file.png"), lambda: Path("/dev/null"),
    lambda: ..., lambda: [None], lambda: [[]], lambda: slice(None), lambda: (math.inf, -1.0),
)  # fmt: skip
TENSORS: tuple[Callable[[], Tensor], ...] = (
    lambda: torch.zeros(0), lambda: torch.tensor(1.5), lambda: torch.tensor(math.nan), lambda: torch.ones(3),
    lambda: torch.rand(2, 3), lambda: torch.zeros(0, 4), lambda: torch.zeros(4, 0), lambda: torch.full((3, 8, 8), 1e30),
    lambda: torch.tensor([True, False]), lambda: torch.ones(2, dtype=torch.complex64), lambda: torch.arange(5),
    lambda: torch.rand(1, 1, 1, 1, 2), lambda: torch.tensor([math.inf, -math.inf, 0.0]), lambda: torch.full((2, 4), -5.0),
    lambda: torch.zeros(3, 4).to(torch.uint8), lambda: torch.rand(2, 8, 8, dtype=torch.float16),
)  # fmt: skip
ARRAYS: tuple[Callable[[], Any], ...] = (
    lambda: np.zeros(0), lambda: np.array(["a", "b"]), lambda: np.array([None, 1]), lambda: np.ones((2, 3), np.float16),
    lambda: np.array(2.0), lambda: np.full((4, 3), np.nan), lambda: np.arange(4, dtype=np.uint64),
)  # fmt: skip


def edge(good: Any, pick: random.Random) -> Any:
    """A value that is wrong or extreme where ``good`` is right; in most cases a near miss."""
    if pick.random() < 0.65:
        if isinstance(good, Tensor):
            return _tensor(good, pick)
        if isinstance(good, np.ndarray):
            if good.dtype.kind not in "fiub":
                return good[:0]
            made = _tensor(torch.from_numpy(good.copy()), pick)
            return (made.float() if made.dtype == torch.bfloat16 else made).numpy()
        if isinstance(good, (int, float, complex)):
            return pick.choice(NUMBERS)
        if isinstance(good, str):
            return pick.choice((good.upper(), good[:-1], good + "x", "", good * 2, None, good[::-1]))
        if isinstance(good, (list, tuple)):
            return _sequence(good, pick)
        if isinstance(good, Mapping):
            return _mapping(good, pick)
    kind = pick.randrange(4)
    if kind == 0:
        return pick.choice(NUMBERS)
    if kind == 1:
        return pick.choice(TENSORS)()
    return pick.choice(ARRAYS if kind == 2 and pick.random() < 0.4 else OTHERS)()


def _tensor(good: Tensor, pick: random.Random) -> Tensor:
    """The tensor in another dtype or shape, or with other numbers in it."""
    what = pick.randrange(14)
    if what == 0:
        kinds = (
            torch.float64,
            torch.float16,
            torch.bfloat16,
            torch.int64,
            torch.uint8,
            torch.bool,
            torch.complex64,
            torch.uint16,
        )
        return good.to(pick.choice(kinds)) if not good.is_complex() else good.abs()
    if what == 1:
        return good[None]
    if what == 2:
        return good[0] if good.ndim and len(good) else good.reshape(1)
    if what == 3:
        return good[:0] if good.ndim else good.new_zeros(0)
    if what == 4:
        return good[..., :0] if good.ndim else good.new_zeros(0)
    if what == 5:
        return good[..., :-1] if good.ndim else good[None]
    if what == 6:
        return torch.cat([good, good], -1) if good.ndim else good[None].expand(3)
    if what == 7:
        return good.flatten()
    if what == 8:
        return good.mT if good.ndim > 1 else good
    if what == 9:
        return good[None].expand(2, *good.shape)
    if what == 10:
        return good[:1] if good.ndim else good
    changed = good.clone()
    if not changed.numel() or changed.dtype == torch.bool:
        return changed
    values = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e30, -1e30, 1e-30, 3.0, 255.0)
    if not (changed.is_floating_point() or changed.is_complex()):
        values = (0.0, 1.0, 200.0, 127.0) if changed.dtype == torch.uint8 else (0.0, -1.0, 1e9, 255.0)
    value = pick.choice(values)
    flat = changed.reshape(-1)
    if what == 11:
        flat[:] = value
    else:
        for _ in range(pick.choice((1, 1, 5))):
            flat[pick.randrange(flat.numel())] = value
    return flat.reshape(changed.shape)


def _sequence(good: Any, pick: random.Random) -> Any:
    items = list(good)
    what = pick.randrange(6)
    if what == 0:
        items = items[:-1]
    elif what == 1:
        items = items * 2
    elif what == 2:
        items = []
    elif what == 3:
        items = items[::-1]
    elif items:
        items[pick.randrange(len(items))] = edge(items[0], pick)
    return tuple(items) if isinstance(good, tuple) else items


def _mapping(good: Mapping[Any, Any], pick: random.Random) -> Any:
    items = dict(good)
    key = pick.choice(list(items) or [None])
    what = pick.randrange(4)
    if what == 0:
        items.pop(key, None)
    elif what == 1:
        items["more"] = 1.0
    elif what == 2:
        items[pick.choice((3, None, "", "\ud800"))] = items.get(key)
    else:
        items[key] = edge(items.get(key), pick)
    return items
