"""Names of files and their endings."""

from __future__ import annotations

import os
import stat
from pathlib import PurePath

from torchweather.core.exceptions import TorchweatherError

__all__ = ["check_no_device", "is_hidden", "stem"]


def is_hidden(path: PurePath) -> bool:
    """True for a name that begins with a dot, which is no data: ``._0.png`` of macOS, ``.Trash-0``.

    Example:
        >>> is_hidden(PurePath("image_2/._0.png")), is_hidden(PurePath(".cache/0.png"))
        (True, False)
    """
    return path.name.startswith(".")


def stem(path: str | os.PathLike[str]) -> tuple[str, str]:
    """Name and ending of a cloud or an image; nuScenes' is ``.pcd.bin``.

    Example:
        >>> stem("sweep.pcd.bin"), stem("velodyne/000008.bin")
        (('sweep', '.pcd.bin'), ('000008', '.bin'))
    """
    pure = PurePath(path)
    for suffix in (".pcd.bin", pure.suffix):
        if suffix and pure.name.lower().endswith(suffix.lower()):
            return pure.name[: len(pure.name) - len(suffix)], pure.name[len(pure.name) - len(suffix) :]
    return pure.name, ""


def check_no_device(path: str | os.PathLike[str]) -> None:
    """Raise `TorchweatherError` for a named pipe, a socket or a device: reading may wait, or never end."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return  # no such file: said by who opens it
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode) or stat.S_ISSOCK(mode) or stat.S_ISBLK(mode):
        raise TorchweatherError(
            f"{path}: expected a file; got a pipe, a socket or a device. Write its content to a file."
        )
