"""Files of a bench: studies to be answered, and apart from them the truth, sealed by its SHA-256 before any answer.

A file may be kept compressed, as ``NAME.gz`` in place of ``NAME``: all readers take either, and its SHA-256 is that of
what was compressed.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = [
    "append_line",
    "keep_packed",
    "plain",
    "read_json",
    "read_lines",
    "sha256_of",
    "stored",
    "write_json",
]


def plain(value: Any) -> Any:
    """Values that JSON can hold: infinities as text, numpy numbers as Python's."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return "inf" if value > 0 else "-inf"
    return value


def stored(path: Path) -> Path | None:
    """The file, or the compressed one in its place; ``None`` where there is neither."""
    packed = path.with_name(path.name + ".gz")
    return next((one for one in (path, packed) if one.exists()), None)


def content(path: Path) -> bytes:
    """Bytes of a file, unpacked where it is kept compressed."""
    found = (stored(path) or path).read_bytes()
    return gzip.decompress(found) if found[:2] == b"\x1f\x8b" else found


def write_whole(path: Path, data: bytes) -> None:
    """Write a file whole or not at all; compressed, with no time in it, where its name ends in ``.gz``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".unfinished")
    unfinished.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)
    os.replace(unfinished, path)


def write_json(path: Path, value: Any) -> None:
    """Write values, whole or not at all."""
    write_whole(path, json.dumps(plain(value), indent=1, sort_keys=True, allow_nan=False).encode() + b"\n")


def read_json(path: Path) -> Any:
    """The values of a file."""
    return json.loads(content(path))


def keep_packed(path: Path, kept: Path) -> Path:
    """Copy a file, compressed unless it is the small seal, and return where it lies."""
    kept = kept if path.name == "seal.json" else kept.with_name(kept.name + ".gz")
    write_whole(kept, content(path))
    return kept


def append_line(path: Path, value: Any) -> None:
    """Add one line of JSON, on the disk before the call returns.

    The line goes out in one write at the end of the file, so that lines of several processes stay whole. What a
    process that was killed left of a line is ended first; a line that another process is writing as well, which leaves
    an empty one.
    """
    line = json.dumps(plain(value), sort_keys=True, allow_nan=False).encode() + b"\n"
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        size = os.fstat(file).st_size
        if size and os.pread(file, 1, size - 1) != b"\n":
            line = b"\n" + line
        os.write(file, line)
        os.fsync(file)
    finally:
        os.close(file)


def read_lines(path: Path) -> list[Any]:
    """The values of a file of lines; a last line that was cut off does not count."""
    if stored(path) is None:
        return []
    found = []
    for line in content(path).decode().splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def sha256_of(path: Path) -> str:
    """Of the bytes of a file, before any compression."""
    return hashlib.sha256(content(path)).hexdigest()
