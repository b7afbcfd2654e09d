"""Operations that ONNX has as one node and torch as several; torch's own wherever no ONNX graph is written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

__all__ = [
    "cells_apart",
    "cells_together",
    "columns_as_rows",
    "columns_at",
    "parts_of",
    "repeated",
    "rows_as_columns",
    "rows_at",
    "shaped_as",
    "writing_onnx",
]

_is_writing = False


@contextmanager
def writing_onnx() -> Iterator[None]:
    """While it is open, a traced program is meant for ONNX alone."""
    global _is_writing
    before, _is_writing = _is_writing, True
    try:
        yield
    finally:
        _is_writing = before


def cells_apart(mosaic: Tensor) -> Tensor:
    """Planes ``(B, 4, H/2, W/2)`` of the places in a cell of two rows and columns, of ``(B, 1, H, W)``."""
    b, _, height, width = mosaic.shape
    if _is_writing:
        return _node("SpaceToDepth", [mosaic], (b, 4, height // 2, width // 2), mosaic.dtype, blocksize=2)
    cells = mosaic.reshape(b, height // 2, 2, width // 2, 2)
    return cells.permute(0, 2, 4, 1, 3).reshape(b, 4, height // 2, width // 2)


def cells_together(planes: Tensor) -> Tensor:
    """Mosaic ``(B, 1, H, W)`` of what ``cells_apart`` gives."""
    b, _, rows, columns = planes.shape
    if _is_writing:
        return _node("DepthToSpace", [planes], (b, 1, 2 * rows, 2 * columns), planes.dtype, blocksize=2)
    return torch.nn.functional.pixel_shuffle(planes, 2)


def parts_of(table: Tensor, sizes: Sequence[int], axis: int = 0) -> list[Tensor]:
    """Neighbouring parts of some sizes along an axis, which they fill."""
    if not _is_writing or len(sizes) == 1:
        return list(torch.split(table, list(sizes), axis))
    shapes = [[*table.shape[:axis], size, *table.shape[axis + 1 :]] for size in sizes]
    places = torch.tensor(list(sizes))
    types = [table.dtype] * len(sizes)
    return list(
        torch.onnx.ops.symbolic_multi_out("Split", [table, places], {"axis": axis}, dtypes=types, shapes=shapes)
    )


def rows_at(table: Tensor, place: Tensor) -> Tensor:
    """Rows of a table ``(n, ...)`` at places of any shape, which come in front of what a row has."""
    if not _is_writing:
        return table[place]
    return _node("Gather", [table, place], (*place.shape, *table.shape[1:]), table.dtype, axis=0)


def columns_at(table: Tensor, place: Tensor) -> Tensor:
    """Columns ``(m, P)`` of a table ``(m, n)`` at places ``(1, P)``."""
    return table.gather(1, place.expand(len(table), -1))


def repeated(maps: Tensor, down: int, across: int) -> Tensor:
    """Maps ``(B, C, H, W)`` that go on at their edges with what is at the other edge, by some rows and columns."""
    *before, height, width = maps.shape
    if _is_writing:
        pads = torch.tensor([0, 0, down, across, 0, 0, down, across])
        shape = (*before, height + 2 * down, width + 2 * across)
        return torch.onnx.ops.symbolic("Pad", [maps, pads], {"mode": "wrap"}, dtype=maps.dtype, shape=shape)
    rows = torch.arange(-down, height + down, device=maps.device) % height
    columns = torch.arange(-across, width + across, device=maps.device) % width
    return maps.index_select(-2, rows).index_select(-1, columns)


def shaped_as(values: Tensor, like: Tensor) -> Tensor:
    """As many values in the shape of another tensor."""
    if not _is_writing:
        return values.reshape(like.shape)
    sizes = _node("Shape", [like], (like.ndim,), torch.int64)
    return _node("Reshape", [values, sizes], like.shape, values.dtype)


def rows_as_columns(table: Tensor) -> Tensor:
    """A table ``(n, m)`` of few columns as ``(m, n)``.

    By a product with ones, which leaves finite numbers as they are: onnxruntime would move a transposition behind
    what follows, where rows of one number are slow.
    """
    if not _is_writing:
        return table.T
    return _node("Gemm", [_ones(table, table.shape[1]), table], (table.shape[1], table.shape[0]), table.dtype, transB=1)


def columns_as_rows(table: Tensor) -> Tensor:
    """A table ``(m, n)`` of few rows as ``(n, m)``; see ``rows_as_columns``."""
    if not _is_writing:
        return table.T
    return _node("Gemm", [table, _ones(table, table.shape[0])], (table.shape[1], table.shape[0]), table.dtype, transA=1)


def _ones(like: Tensor, size: int) -> Tensor:
    return torch.from_numpy(np.eye(size, dtype=np.float32)).to(like)


def _node(
    name: str, inputs: list[Tensor | None], shape: Sequence[int], dtype: torch.dtype, **attributes: int
) -> Tensor:
    """One node of a graph."""
    return torch.onnx.ops.symbolic(name, inputs, {**attributes}, dtype=dtype, shape=shape)
