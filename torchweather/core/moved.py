"""Names that have moved or changed: the old one works for one release, with a warning that gives the new one."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

__all__ = ["moved", "renamed"]


def moved(old: str, homes: str | Sequence[str] | Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """``__getattr__`` of a module whose names, or some of them, live elsewhere now.

    Args:
        old: name of the module.
        homes: the module that has all names now, or several, searched in their order by ``__all__``; or for each new
            module the names that went there.

    Example:
        >>> find = moved("torchweather.old", {"math": ("pi",)})
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     round(find("pi"), 2)
        3.14
    """

    def find(name: str) -> Any:
        home = None if name.startswith("__") else _home(homes, name)
        if home is None:
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(home), name)
        text = f"{old}.{name} has moved to {home}.{name}; the old path goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return value

    return find


def _home(homes: str | Sequence[str] | Mapping[str, Sequence[str]], name: str) -> str | None:
    """The module that has a name now; ``None`` where none has."""
    if isinstance(homes, str):
        return homes
    if isinstance(homes, Mapping):
        return next((new for new, names in homes.items() if name in names), None)
    return next((new for new in homes if name in importlib.import_module(new).__all__), None)


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
