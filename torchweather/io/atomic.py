"""Files that are either written whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torchweather.errors import TorchweatherError

__all__ = ["atomic_write"]


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary name beside ``path`` to write to; it takes the place of ``path`` when the block ends well.

    When the block raises, the temporary file is removed and what stood at ``path`` stays as it was. The temporary
    name keeps the suffix, because many writers choose the format by it.

    Args:
        path: the file to be written; its folder must exist.

    Example:
        >>> import tempfile
        >>> target = Path(tempfile.mkdtemp()) / "numbers.txt"
        >>> with atomic_write(target) as unfinished:
        ...     _ = unfinished.write_text("1 2 3")
        >>> target.read_text()
        '1 2 3'
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise TorchweatherError(f"{target}: cannot be written, there is no folder {target.parent}. Create it first.")
    unfinished = target.with_name(f".{target.stem[:100]}.{uuid.uuid4().hex}{target.suffix}")
    try:
        yield unfinished
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)
