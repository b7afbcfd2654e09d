"""Names of files and their endings."""

from __future__ import annotations

import os
from pathlib import PurePath

__all__ = ["stem"]


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
