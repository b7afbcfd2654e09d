"""Layouts of point files without a header: columns that the user states, and a check that the numbers fit them.

Nothing in such a file says how many columns it has. Read with the wrong number, every column mixes all quantities: a
reflectance takes the place of a coordinate. The numbers themselves show it: in the right layout a column is of one kind
(whole numbers, one sign, one order of magnitude), in a wrong one its kind is that of the whole file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.io.stored_points import PADDING, PointField, row_dtype

__all__ = ["check_rows", "likely_layout", "looks_semantic", "stated_fields"]

Bytes = npt.NDArray[np.uint8]

_NAMES = ("x", "y", "z", "intensity", "ring", "time", "column_6", "column_7")
# No coordinate in metres, intensity or time is larger, and none but 0 smaller: integers and halves of float64 are.
_LARGEST, _SMALLEST = 1e7, 1e-18
_BRIGHTEST = 1e6
# Share of rows that may hold such a number: marks of no return, single bits.
_FEW = 0.01
# Numbers that are compared, and those in a piece that is taken whole; columns repeat within a piece.
_SAMPLE, _PIECE = 9_600, 1_200
# Another width must explain this much more of the numbers' kinds: by itself, and for each class that chance can use.
_MORE, _MORE_A_CLASS = 0.1, 8.0
_FEWEST_ROWS = 16
# Two rows are one point: twice the width explains so much more, the parity of the row explains so much of the kinds of
# a column, and this share of the rows differs.
_TWICE, _HALVES, _DISTINCT = 0.25, 0.5, 0.25
_CARLA = (*((name, "<f4") for name in ("x", "y", "z", "intensity")), ("object_id", "<u4"), ("object_tag", "<u4"))
_MAGIC = {
    b"\x00\x05\x16\x07": "what macOS keeps beside a file (AppleDouble), no points",
    b"\x93NUMPY": "a NumPy array (.npy)",
    b"PK\x03\x04": "an archive (.npz or .zip)",
    b"\x1f\x8b": "compressed by gzip",
    b"\x89PNG": "a PNG image",
    b"LASF": "a LAS cloud (.las or .laz)",
    b"ply\n": "a PLY cloud (format='ply')",
    b"ply\r": "a PLY cloud (format='ply')",
    b"# .PCD": "a PCD cloud (format='pcd')",
    b"VERSION": "a PCD cloud (format='pcd')",
}


@dataclass(frozen=True)
class _Candidate:
    fields: tuple[PointField, ...]
    words: str

    @property
    def statement(self) -> str:
        """The value of ``bin_columns``."""
        plain = all(one.dtype == "<f4" for one in self.fields)
        return ",".join(one.name if plain else f"{one.name}:{np.dtype(one.dtype).name}" for one in self.fields)


def _floats(columns: int, dtype: str) -> _Candidate:
    fields = tuple(PointField(name, dtype) for name in _NAMES[:columns])
    return _Candidate(fields, f"{columns} columns of {np.dtype(dtype).name}")


_FLOAT32 = {columns: _floats(columns, "<f4") for columns in range(3, 9)}
_FLOAT64 = {columns: _floats(columns, "<f8") for columns in range(3, 9)}
_SEMANTIC = _Candidate(tuple(PointField(*one) for one in _CARLA), "CARLA's semantic LiDAR, 24 bytes a point")


def stated_fields(columns: str | Sequence[str], dtype: str = "float32") -> tuple[PointField, ...]:
    """The fields of a row, as the user states them.

    Args:
        columns: names in the order of the file, ``"x,y,z,intensity,ring"`` or a sequence; ``name:uint16`` has a type of
            its own, ``_:uint8`` is padding.
        dtype: type of the columns without one.

    Example:
        >>> [one.dtype for one in stated_fields("x,y,z,intensity,ring:uint16")]
        ['<f4', '<f4', '<f4', '<f4', '<u2']
    """
    check_arguments("bin_columns(columns: str | Sequence[str])", columns)
    words = [word.strip() for word in columns.split(",")] if isinstance(columns, str) else list(columns)
    fields = []
    for word in words:
        name, _, own = word.partition(":")
        try:
            code = np.dtype(own or dtype)
        except TypeError as error:
            raise InputValueError(
                f"bin_columns: expected a number's type such as float32, float64, uint8, uint16 or int32; got "
                f"{own or dtype!r}. Pass e.g. bin_columns='x,y,z,intensity,ring:uint16'."
            ) from error
        if code.kind not in "fiu" or code.itemsize > 8 or not name:
            raise InputValueError(
                f"bin_columns: expected names with number types, name or name:type; got {word!r}. Pass e.g. "
                "bin_columns='x,y,z,intensity,ring'."
            )
        fields.append(PointField(name, code.newbyteorder("<").str if code.byteorder != ">" else code.str))
    names = [one.name for one in fields if one.name != PADDING]
    if not {"x", "y", "z"} <= {name.lower() for name in names} or len(set(names)) < len(names):
        raise InputValueError(
            f"bin_columns: expected x, y, z and other names, each once; got {', '.join(names)}. Pass e.g. "
            "bin_columns='x,y,z,intensity,ring'."
        )
    return tuple(fields)


def check_rows(content: Bytes, columns: int, meaning: str, source: Path) -> None:
    """Refuse a file whose numbers do not look like rows of so many float32 columns, and name the likely layout.

    Args:
        content: all bytes of the file, a multiple of a row.
        columns: x, y, z, intensity and further ones.
        meaning: of the columns, for messages.
        source: the file, for messages.
    """
    evidence = _kind_of_file(content) or _odd_numbers(content, _FLOAT32[columns].fields)
    likely = None
    if not evidence:
        likely = _better(content, columns)
        evidence = "" if likely is None else "each column mixes numbers of several kinds"
    if not evidence:
        return
    likely = likely or _likely(content, without=columns)
    plain = _FLOAT32[columns].statement
    advice = (
        f"The likely layout is {likely.words}: state it with bin_columns={likely.statement!r} (command line: "
        f"--bin-columns {likely.statement})."
        if likely is not None
        else "State its columns with bin_columns='x,y,z,...' (command line: --bin-columns)."
    )
    raise TorchweatherError(
        f"{source}: expected rows of {columns} float32 numbers ({meaning}); got other content: {evidence}. {advice} If "
        f"it is as wanted all the same, state bin_columns={plain!r}."
    )


def likely_layout(content: Bytes) -> str:
    """The likely layout of a file in words, with what to pass; empty where none stands out."""
    kind = _kind_of_file(content)
    if kind:
        return f"It is {kind}." if not kind.startswith("it") else kind
    likely = _likely(content)
    return "" if likely is None else f"The likely layout is {likely.words}: bin_columns={likely.statement!r}."


def _kind_of_file(content: Bytes) -> str:
    """Content that is told by its first bytes, or text."""
    head = content[:4096].tobytes()
    for magic, words in _MAGIC.items():
        if head.startswith(magic):
            return f"it is {words}"
    printable = set(b"\t\n\r") | set(range(32, 127))
    if len(head) >= 16 and set(head) <= printable:
        return "it is text"
    return ""


def _table(content: Bytes, fields: tuple[PointField, ...], rows: Any = None) -> npt.NDArray[np.float64]:
    """The first columns of the rows as float64, ``(N, C)``."""
    rows = content.view(row_dtype(fields)) if rows is None else rows
    with np.errstate(invalid="ignore"):  # signalling NaN
        return np.stack([rows[f"f{k}"].astype(np.float64) for k in range(len(fields))], axis=1)


def _odd_numbers(content: Bytes, fields: tuple[PointField, ...]) -> str:
    """Evidence that the numbers are not positions and intensities; empty where they may be."""
    plain = all(one.dtype == "<f4" for one in fields)
    usual = False
    if plain:  # one look at the numbers as they are shows that there is nothing to look for
        words = content.view("<f4").reshape(-1, len(fields))
        with np.errstate(invalid="ignore"):  # NaN
            size = np.abs(words)
            usual = bool(size.max(initial=0.0) <= _BRIGHTEST) and not bool((words[:, 3:4] < 0).any())
            usual = usual and not bool(((size > 0) & (size < _SMALLEST)).any())
    if not usual:
        evidence = _odd_rows(content, fields)
        if evidence:
            return evidence
    flat = content.view("<f4") if plain and content.size >= 4 * len(fields) * _FEWEST_ROWS else np.zeros(0, np.float32)
    if flat.size and not flat[0::2].any() and flat[1::2].any() and _float64_fits(content):
        return "every other number is 0, as the lower halves of float64 are"
    return ""


def _odd_rows(content: Bytes, fields: tuple[PointField, ...]) -> str:
    """The same, row by row."""
    table = _table(content, fields)
    finite = np.isfinite(table)
    returns = finite[:, :3].any(axis=1)
    if not bool(returns.any()):
        return "no row holds finite numbers for x, y and z"
    broken = returns & ~finite.all(axis=1)
    if _many(broken):
        return f"{int(broken.sum())} of {len(table)} rows hold NaN or infinity beside numbers"
    if len(fields) > 3:
        negative = returns & (table[:, 3] < 0)
        if _many(negative):
            return f"{int(negative.sum())} of {len(table)} rows have a negative intensity"
    size = np.abs(np.where(np.isfinite(table), table, 0.0))
    odd = ((size > _LARGEST) | ((size > 0) & (size < _SMALLEST))).any(axis=1)
    if _many(odd):
        limits = f"above {_LARGEST:g} or, but for 0, below {_SMALLEST:g}"
        return f"{int(odd.sum())} of {len(table)} rows hold numbers {limits}"
    if len(fields) > 3 and _many(size[:, 3] > _BRIGHTEST):
        return f"{int((size[:, 3] > _BRIGHTEST).sum())} of {len(table)} rows have an intensity above {_BRIGHTEST:g}"
    return ""


def _many(rows: Any) -> bool:
    """True where a mask of rows holds more than a few."""
    return bool(rows.sum() > _FEW * len(rows))


def _float64_fits(content: Bytes) -> bool:
    if content.size % 8:
        return False
    size = np.abs(content.view("<f8"))
    return bool(((size == 0) | ((size > _SMALLEST) & (size < _LARGEST))).all())


def _likely(content: Bytes, without: int | None = None) -> _Candidate | None:
    """The layout that explains the numbers best, of those that can."""
    if looks_semantic(content):
        return _SEMANTIC
    size = content.size
    best, most = None, 0.0
    for dtype, candidates in (("<f4", _FLOAT32), ("<f8", _FLOAT64)):
        for columns, one in candidates.items():
            if size % (columns * np.dtype(dtype).itemsize) or (dtype == "<f4" and columns == without):
                continue
            if size // (columns * np.dtype(dtype).itemsize) < _FEWEST_ROWS or _odd_numbers(content, one.fields):
                continue
            sampled = _Sampled.of(content.view(dtype))
            surplus = sampled.explained(columns) - _MORE_A_CLASS * columns / max(sampled.places.size, 1)
            if surplus > most + (0.02 if best is not None else 0.0):  # a multiple of the width explains no less
                best, most = one, surplus
    return best


def looks_semantic(content: Bytes) -> bool:
    """True where a buffer holds the points of CARLA's semantic LiDAR: four floats, an object's number, a small tag."""
    if not content.size or content.size % 24:
        return False
    rows = content.view(row_dtype(_SEMANTIC.fields))
    # A float32 that is not 0 is above 2^23 as an integer; CARLA's actors and tags have small numbers.
    if not bool(((rows["f4"] < 1 << 23) & (rows["f5"] < 256)).all()):
        return False
    table = _table(content, _SEMANTIC.fields[:4], rows)
    size = np.abs(table)
    odd = ~(size < _LARGEST) | ((size > 0) & (size < _SMALLEST))
    return not bool(odd.any()) and bool((size[:, 3] <= 1.0 + 1e-6).all()) and bool((size[:, :3] > 0).any())


def _better(content: Bytes, columns: int) -> _Candidate | None:
    """A width that explains the kinds of numbers clearly better than the one that is wanted."""
    numbers: Any = content.view("<f4")
    if numbers.size < columns * _FEWEST_ROWS:
        return None
    sampled = _Sampled.of(numbers)
    own, count = sampled.explained(columns), sampled.places.size
    best, most = None, own
    for other, one in _FLOAT32.items():
        if numbers.size % other or other % columns == 0:
            continue
        explained = sampled.explained(other)
        if explained - own > _MORE + _MORE_A_CLASS * other / count and explained > most + 0.02:
            if _odd_numbers(content, one.fields):
                continue
            best, most = one, explained
    double = 2 * columns
    if best is None and double in _FLOAT32 and numbers.size % double == 0:
        explained = sampled.explained(double)
        if explained - own > _TWICE and _halves_differ(numbers, columns):
            return _FLOAT32[double]
    return best


def _sample(numbers: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Places of the numbers that are looked at: all, or pieces from the whole file."""
    if numbers.size <= _SAMPLE:
        return np.arange(numbers.size)
    starts = np.linspace(0, numbers.size - _PIECE, _SAMPLE // _PIECE).astype(np.int64)
    return (starts[:, None] + np.arange(_PIECE)).reshape(-1)


def _kinds(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Kinds of numbers, ``(3, n)``: whole or not, sign, order of magnitude."""
    with np.errstate(invalid="ignore"):
        wide = values.astype(np.float64)
    size = np.abs(wide)
    return np.stack([(wide == np.rint(wide)).astype(np.float64), np.sign(wide), np.log10(np.clip(size, 1e-3, 1e6))])


@dataclass(frozen=True)
class _Sampled:
    """Numbers that are looked at: their places in the file and their kinds."""

    places: npt.NDArray[np.int64]
    kinds: npt.NDArray[np.float64]

    @classmethod
    def of(cls, numbers: npt.NDArray[Any]) -> _Sampled:
        """Those of a file."""
        places = _sample(numbers)
        values = numbers[places]
        known = np.isfinite(values)
        return cls(places[known], _kinds(values[known]))

    def explained(self, columns: int) -> float:
        """Share of the variance of the kinds that the place in a row of so many columns explains."""
        return _share(self.kinds, self.places % columns) if self.places.size else 0.0


def _share(kinds: npt.NDArray[np.float64], classes: npt.NDArray[np.int64]) -> float:
    count = np.bincount(classes)
    shares = []
    for kind in kinds:
        away = kind - kind.mean()
        total = float((away**2).sum())
        if total > 1e-9 * len(kind):
            means = np.bincount(classes, away) / np.maximum(count, 1)
            shares.append(float((count * means**2).sum()) / total)
    return float(np.mean(shares)) if shares else 0.0


def _halves_differ(numbers: npt.NDArray[Any], columns: int) -> bool:
    """True where rows of even and odd number differ in kind in two columns at least; rows that repeat say nothing."""
    rows = numbers.reshape(-1, columns)
    step = max(1, len(rows) // (2 * _PIECE))
    at = np.arange(0, len(rows) - 1, 2)[::step]
    pairs = np.concatenate([rows[at], rows[at + 1]])
    if not bool(np.isfinite(pairs).all()) or len(np.unique(pairs, axis=0)) < _DISTINCT * len(pairs):
        return False
    parity = np.repeat(np.array([0, 1], np.int64), len(at))
    return sum(_share(_kinds(pairs[:, column]), parity) > _HALVES for column in range(columns)) >= 2
