"""Digests of results: exact, for the machine that made the record, and a few numbers, for any other machine."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

Array = npt.NDArray[Any]
WAVES = (0.7548776662466927, 0.5698402909980532)  # irrational, so that no permutation of the values gives the same sums


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Arrays, numbers, texts and bytes in nested containers and dataclasses, each with its place."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        for key in value:
            yield from leaves(value[key], f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        yield f"{path}#", len(value)
        for place, one in enumerate(value):
            yield from leaves(one, f"{path}[{place}]")
    elif isinstance(value, torch.nn.Module):
        yield from leaves(value.state_dict(), path)
    elif isinstance(value, torch.Tensor):
        yield path, value.detach().cpu().numpy()
    elif isinstance(value, np.ndarray | np.generic | str | bytes | bool | int | float):
        yield path, value
    elif value is not None:  # a field that is new and unset is no other answer
        yield path, type(value).__name__


def exact(value: Any) -> str:
    """Hash of every bit of a result, with its places, shapes and types."""
    found = hashlib.sha256()
    for path, leaf in leaves(value):
        found.update(path.encode())
        if isinstance(leaf, np.ndarray | np.generic):
            array = np.ascontiguousarray(leaf)
            found.update(f"{array.dtype}{array.shape}".encode())
            found.update(array.tobytes())
        elif isinstance(leaf, bytes):
            found.update(leaf)
        else:
            found.update(repr(leaf).encode())
    return found.hexdigest()[:16]


def numbers(value: Any) -> list[float]:
    """A few numbers of a result: count of places, of values, of finite ones, and weighted sums of the values."""
    sums = np.zeros(len(WAVES))
    places = values = finite = 0
    size = 0.0
    for _, leaf in leaves(value):
        places += 1
        array = _as_numbers(leaf)
        values += array.size
        good = np.isfinite(array)
        finite += int(good.sum())
        kept = np.where(good, array, 0.0)
        size += float(np.abs(kept).sum())
        where = np.arange(array.size) + places
        sums += [float((kept * np.cos(2.0 * math.pi * wave * where)).sum()) for wave in WAVES]
    return [float(places), float(values), float(finite), size, *sums.tolist()]


def agree(one: list[float], other: list[float], rtol: float) -> bool:
    """Whether two lists of `numbers` are of the same result but for rounding."""
    counts = 3
    within = rtol * max(one[counts], other[counts], 1e-30)
    near = all(abs(a - b) <= within for a, b in zip(one[counts:], other[counts:], strict=True))
    return one[:counts] == other[:counts] and near


def _as_numbers(leaf: Any) -> npt.NDArray[np.float64]:
    if isinstance(leaf, np.ndarray | np.generic):
        array = np.asarray(leaf)
        if array.dtype.kind in "biuf":
            return array.astype(np.float64).reshape(-1)
        if array.dtype.kind == "c":
            return np.stack([array.real, array.imag], -1).astype(np.float64).reshape(-1)
        leaf = json.dumps(array.tolist())
    if isinstance(leaf, bool | int | float):
        return np.array([float(leaf)])
    text = leaf if isinstance(leaf, bytes) else repr(leaf).encode()
    return np.frombuffer(hashlib.sha256(text).digest()[:4], np.uint8).astype(np.float64)
