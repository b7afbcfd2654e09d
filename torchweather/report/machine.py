"""The machine that made a page, and what the library warned of meanwhile."""

from __future__ import annotations

import os
import platform
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch

from torchweather.core.errors import TorchweatherWarning

__all__ = ["library_warnings", "machine", "machine_text"]


def machine() -> dict[str, Any]:
    """Processor, cores and threads, for a summary."""
    return {
        "torch": torch.__version__,
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "device": "cpu",
    }


def machine_text(found: Mapping[str, Any]) -> str:
    """The same in a few words."""
    return f"{found['threads']} of {found['cores']} cores, torch {found['torch']}"


@contextmanager
def library_warnings() -> Iterator[list[str]]:
    """A list that holds the library's warnings once the block is left, each once; other warnings go on."""
    said: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield said
    for warning in caught:
        if not issubclass(warning.category, TorchweatherWarning):
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
        elif str(warning.message) not in said:
            said.append(str(warning.message))
