"""Names that have moved or changed: the old one works for one release, with a warning that gives the new one."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from torchweather.core.exceptions import InputTypeError

__all__ = ["moved", "new_names", "renamed", "renamed_arguments"]

P = ParamSpec("P")
R = TypeVar("R")


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


def renamed_arguments(**names: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator of a function some of whose keyword arguments have other names now; the old ones work with a warning.

    Args:
        names: old name of an argument to the new one.

    Example:
        >>> @renamed_arguments(size="width_px")
        ... def area(width_px): return width_px**2
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     area(size=3)
        9
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def call(*args: P.args, **more: P.kwargs) -> R:
            given = new_names(more, names, function.__qualname__.removesuffix(".__init__"), stacklevel=2)
            return function(*args, **given)

        return call

    return decorated


def new_names(values: Mapping[str, Any], names: Mapping[str, str], owner: str, stacklevel: int = 1) -> dict[str, Any]:
    """Values by name, those with an old name under the new one, with a warning.

    Args:
        values: by name.
        names: old name to the new one.
        owner: of the values, for the warning.
        stacklevel: of the warning, 1 for the caller's own line.

    Raises:
        InputTypeError: both names are given.
    """
    found = dict(values)
    for old in [name for name in names if name in values]:
        new = names[old]
        if new in values:
            raise InputTypeError(f"{owner}: {old} is the old name of {new}; both were given. Leave {old} out.")
        text = f"{owner}: {old} is {new} now; the old name goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=stacklevel + 1)
        found[new] = found.pop(old)
    return found
