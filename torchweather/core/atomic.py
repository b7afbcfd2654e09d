"""Files and folders that are either written whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from torchweather.core.errors import TorchweatherError

__all__ = ["atomic_folder", "atomic_write", "durable"]

_DURABLE: ContextVar[bool] = ContextVar("durable", default=True)


@contextmanager
def durable(on: bool) -> Iterator[None]:
    """Within the block ``atomic_write`` waits until the disk has a file, or does not, which is faster.

    Without, files are still whole or not there after the end of a process, but not after a power cut.

    Example:
        >>> with durable(False):
        ...     pass  # write many files
    """
    token = _DURABLE.set(on)
    try:
        yield
    finally:
        _DURABLE.reset(token)


def _to_disk(path: Path) -> None:
    """Wait until the disk has a file or the names in a folder, where the system can tell."""
    if not _DURABLE.get():
        return
    try:
        handle = os.open(path, os.O_RDONLY)
    except (FileNotFoundError, PermissionError):  # nothing was written; Windows opens no folders
        return
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(handle)


# File systems that cannot sync a folder say so.
_CANNOT_SYNC = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary name beside ``path`` to write to; it takes the place of ``path`` when the block ends well.

    When the block raises, the temporary file is removed and what stood at ``path`` stays as it was. File and folder are
    on the disk when the block ends, also after a power cut; ``durable(False)`` does without. The temporary name keeps
    the suffix, because many writers choose the format by it.

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
    if target.is_dir():
        raise TorchweatherError(f"{target}: cannot be written, it is a folder. Give the name of a file.")
    unfinished = target.with_name(f".{target.stem[:100]}.{uuid.uuid4().hex}{target.suffix}")
    try:
        yield unfinished
        _to_disk(unfinished)  # before its name is: after a power cut the name would hold an empty file
        unfinished.replace(target)
        _to_disk(target.parent)
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def atomic_folder(out_dir: Path) -> Iterator[Path]:
    """A folder beside ``out_dir`` whose files move into it when the block ends well, ``index.html`` last.

    When the block raises, nothing is left of it and what stood in ``out_dir`` stays as it was.

    Args:
        out_dir: made where it does not exist; what it holds stays, unless it has the same name.
    """
    if out_dir.exists() and not out_dir.is_dir():
        raise TorchweatherError(f"{out_dir}: expected a folder to write to; got a file.")
    out_dir = out_dir.absolute()
    made = [folder for folder in (out_dir, *out_dir.parents) if not folder.exists()]
    try:
        out_dir.parent.mkdir(parents=True, exist_ok=True)
        staging = out_dir.parent / f".{out_dir.name[:100]}.{uuid.uuid4().hex}"
        staging.mkdir()
    except OSError as error:
        raise TorchweatherError(f"{out_dir}: cannot be written ({error.strerror}). Choose another folder.") from error
    try:
        yield staging
        files = sorted((f for f in staging.rglob("*") if f.is_file()), key=lambda f: (f.name == "index.html", f))
        for file in files:
            target = out_dir / file.relative_to(staging)
            target.parent.mkdir(parents=True, exist_ok=True)
            _to_disk(file)
            file.replace(target)
        _to_disk(out_dir)
    except BaseException:
        for folder in made[1:]:
            shutil.rmtree(staging, ignore_errors=True)
            if not any(folder.iterdir()):
                folder.rmdir()
        raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)
