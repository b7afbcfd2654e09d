"""Names that have moved or changed: the old one works for one release, with a warning that gives the new one."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

__all__ = ["moved", "renamed"]


def moved(old: str, homes: str | Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """``__getattr__`` of a module whose names, or some of them, live elsewhere now.

    Args:
        old: name of the module.
        homes: the module that has all names now; or for each new module the names that went there.

    Example:
        >>> find = moved("torchweather.old", {"math": ("pi",)})
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     round(find("pi"), 2)
        3.14
    """

    def find(name: str) -> Any:
        home = homes if isinstance(homes, str) else next((new for new, names in homes.items() if name in names), None)
        if home is None or name.startswith("__"):
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(home), name)
        text = f"{old}.{name} has moved to {home}.{name}; the old path goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return value

    return find


def renamed(old: str, names: str | Mapping[str, tuple[str, Any]]) -> Callable[[str], Any]:
    """``__getattr__`` of a module whose names are others now.

    Args:
        old: name of the module.
        names: each old name to the new one in words, and the object; or the module that has them as ``RENAMED``.
    """

    def find(name: str) -> Any:
        table: Any = importlib.import_module(names).RENAMED if isinstance(names, str) else names
        if name not in table:
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        new, value = table[name]
        text = f"{old}.{name} is {new} now; the old name goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return value

    return find
