"""Operations that ONNX has as one node and torch as several; torch's own wherever no ONNX graph is written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

__all__ = [
    "cells_apart",
    "cells_together",
    "columns_at",
    "entries_at",
    "last_row_and_column",
    "parts_of",
    "repeated",
    "rows_as_columns",
    "rows_at",
    "shaped_as",
    "sums_before",
    "sums_of_rows",
    "weighted_sum",
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


def entries_at(row: Tensor, place: Tensor) -> Tensor:
    """Entries ``(1, ...)`` of a row ``(1, n)`` at places of any shape."""
    if not _is_writing:
        return row[:, place]
    return _node("Gather", [row, place], (1, *place.shape), row.dtype, axis=1)


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


def sums_of_rows(
    rows: Mapping[str, Tensor], sums: Sequence[Mapping[str, float]], *, as_columns: bool = False
) -> Tensor:
    """Weighted sums ``(m, P)`` of rows ``(1, P)``, one for each mapping of a row's name to its weight.

    The name ``""`` is a constant; row k of a table ``(n, P)`` is ``name.k``.

    Args:
        rows: finite numbers.
        sums: the weights.
        as_columns: give ``(P, m)``.
    """
    names = [f"{name}.{k}" if len(one) > 1 else name for name, one in rows.items() for k in range(len(one))]
    if _is_writing:
        table = torch.cat(list(rows.values()))
        weights = np.array([[one.get(name, 0.0) for name in names] for one in sums], np.float32)
        constants = torch.from_numpy(np.array([[one.get("", 0.0)] for one in sums], np.float32)).to(table)
        if as_columns:
            shape, turned = (table.shape[1], len(sums)), torch.from_numpy(weights.T.copy()).to(table)
            return _node("Gemm", [table, turned, constants.flatten()], shape, table.dtype, transA=1)
        shape = (len(sums), table.shape[1])
        return _node("Gemm", [torch.from_numpy(weights).to(table), table, constants], shape, table.dtype)
    # Not by a product of matrices, which a GPU may round to 10 bits.
    each = dict(zip(names, (row for table in rows.values() for row in table.split(1)), strict=True))  # type: ignore[no-untyped-call]
    found = torch.cat([_sum([(weight, each[name]) for name, weight in one.items() if name]) for one in sums])
    if any("" in one for one in sums):
        found = found + found.new_tensor([[one.get("", 0.0)] for one in sums])
    return found.T if as_columns else found


def weighted_sum(table: Tensor, weights: Sequence[float]) -> Tensor:
    """Sum ``(1, P)`` of the rows of a table ``(m, P)`` with weights."""
    if _is_writing:
        row = torch.from_numpy(np.array([weights], np.float32)).to(table)
        return _node("MatMul", [row, table], (1, table.shape[1]), table.dtype)
    return _sum(list(zip(weights, table.split(1), strict=True)))  # type: ignore[no-untyped-call]


def _sum(terms: Sequence[tuple[float, Tensor]]) -> Tensor:
    (weight, one), *others = terms
    total = one if weight == 1 else weight * one
    for weight, one in others:
        total = torch.add(total, one, alpha=weight)
    return total


def sums_before(values: Tensor) -> Tensor:
    """Of each of ``(n,)`` numbers the sum of all before it."""
    if not _is_writing:
        return torch.cumsum(values, 0) - values
    return _node("CumSum", [values, torch.tensor(0)], values.shape, values.dtype, exclusive=1)


def last_row_and_column(size: tuple[int, int], like: Tensor) -> Tensor:
    """Numbers ``(2, 1)`` of the last row and column of an image of a size."""
    if not _is_writing:
        return like.new_tensor([[size[0] - 1.0], [size[1] - 1.0]])
    return torch.stack([torch.scalar_tensor(one, dtype=like.dtype) for one in size])[:, None] - 1.0


def _ones(like: Tensor, size: int) -> Tensor:
    return torch.from_numpy(np.eye(size, dtype=np.float32)).to(like)


def _node(
    name: str, inputs: Sequence[Tensor | None], shape: Sequence[int], dtype: torch.dtype, **attributes: int
) -> Tensor:
    """One node of a graph."""
    return torch.onnx.ops.symbolic(name, [*inputs], {**attributes}, dtype=dtype, shape=shape)
