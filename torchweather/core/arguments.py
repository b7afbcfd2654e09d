"""Kinds and shapes of arguments, each declared in one line and refused by name."""

from __future__ import annotations

import difflib
import inspect
import math
import numbers
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.core.exceptions import InputTypeError, InputValueError, TorchweatherError
from torchweather.core.file_names import check_no_device

__all__ = ["call_given", "check_arguments", "check_broadcast", "check_options", "nested_shape"]

Sizes = dict[str, int]


def check_arguments(head: str, *values: object) -> None:
    """Raise unless arguments are of the kinds and shapes that the head of a function declares.

    Kinds are ``float``, ``Quantity`` (a number or a tensor), ``Nested`` (the same without a single number),
    ``int``, ``bool``, ``str``, ``path``, ``Mapping``,
    ``Sequence``, ``Iterable``, ``Callable``, ``None``, ``array`` (numpy, of real numbers), tensors (``Tensor`` of any
    dtype, ``real``, ``floating``, ``whole``, ``mask``) and names of classes. ``|`` stands between kinds that are all
    allowed. A tensor's shape follows in brackets: a number, ``3+`` for three or more, a letter for a size that is the
    same wherever it stands, ``...`` for any axes in front. Square brackets hold the kind of a
    sequence's elements or of a mapping's keys: ``Sequence[float]``. Inside a compiled graph no argument is checked.

    Args:
        head: such as ``"project(points: floating(..., N, 3+), camera: Camera)"``.
        values: of the parameters in it, in their order.

    Raises:
        InputTypeError: an argument of another kind.
        InputValueError: a tensor of another shape, a path that no file can have.

    Example:
        >>> check_arguments("mosaic(rgb: real(..., 3, H, W), pattern: str)", torch.rand(3, 4, 6), "RGGB")
        >>> check_arguments("mosaic(rgb: real(..., 3, H, W), pattern: str)", torch.rand(4, 6), "RGGB")
        Traceback (most recent call last):
        torchweather.core.exceptions.InputValueError: mosaic: rgb must have shape (..., 3, H, W); got (4, 6).
    """
    if torch.compiler.is_compiling():
        return
    owner, parameters = _declared(head)
    sizes: Sizes = {}
    for (name, kinds), value in zip(parameters, values, strict=True):
        fitting = [kind for kind in kinds if kind.fits(value)]
        if not fitting:
            words = " or ".join(dict.fromkeys(kind.words for kind in kinds))
            raise InputTypeError(f"{owner}: {name} must be {words}; got {_shown(value)}.")
        if isinstance(value, Tensor):
            _check_shape(owner, name, fitting[0].shape, value, sizes)
        elif fitting[0].name == "path":
            _check_path(owner, name, os.fspath(value))  # type: ignore[call-overload]


def call_given(owner: str, name: str, function: Callable[..., Any], *values: object) -> Any:
    """Result of a user's function for some values; `InputTypeError` where it does not take them.

    Example:
        >>> call_given("gain", "law", abs, -1.5)
        1.5
        >>> call_given("gain", "law", len, 1.5)
        Traceback (most recent call last):
        torchweather.core.exceptions.InputTypeError: gain: law must take what it is called with; got ...
    """
    try:
        return function(*values)
    except TorchweatherError:
        raise
    except (TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise InputTypeError(
            f"{owner}: {name} must take what it is called with; got {_shown(function)}, which raises "
            f"{type(error).__name__}: {str(error)[:200]}."
        ) from error


def check_options(owner: str, kind: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Refuse an option that a function or class has not, with the nearest name.

    Example:
        >>> check_options("Camera", math.hypot, {})
        >>> check_options("sorted", sorted, {"revers": True})
        Traceback (most recent call last):
        torchweather.core.exceptions.InputValueError: sorted: 'revers' is no option of sorted. Did you mean 'reverse'?
    """
    check_arguments(f"{owner}(options: Mapping[str])", options)
    if not options:
        return
    known = list(inspect.signature(kind).parameters)
    for name in options:
        if name not in known:
            near = difflib.get_close_matches(name[:100], known, n=1)
            advice = f" Did you mean {near[0]!r}?" if near else ""
            raise InputValueError(f"{owner}: {name[:100]!r} is no option of {kind.__name__}.{advice}")


def check_broadcast(owner: str, **values: object) -> None:
    """Raise `InputValueError` unless the tensors and arrays among some arguments broadcast.

    Example:
        >>> check_broadcast("gain", azimuth_rad=torch.zeros(3), elevation_rad=torch.zeros(2, 1), height_m=1.0)
    """
    if torch.compiler.is_compiling():
        return
    shapes = {name: _shape(value) for name, value in values.items()}
    if len(set(shapes.values())) < 2:
        return
    try:
        np.broadcast_shapes(*shapes.values())  # that of torch imports sympy, half a second
    except ValueError as error:
        words = ", ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
        raise InputValueError(f"{owner}: shapes must broadcast; got {words}.") from error


def _shape(value: object) -> tuple[int, ...]:
    if isinstance(value, (Tensor, np.ndarray)):
        return tuple(value.shape)
    return nested_shape(value) or ()


@dataclass(frozen=True)
class _Kind:
    """One kind of a parameter: its name, the shape in it, the kind of its elements."""

    name: str
    shape: tuple[str, ...] | None = None
    element: _Kind | None = None

    @property
    def words(self) -> str:
        if self.name in _KINDS:
            words = _KINDS[self.name][0]
            return words if self.element is None else f"{words} of {self.element.name}"
        return f"a {self.name}"

    def fits(self, value: Any) -> bool:
        if self.name not in _KINDS:  # by name, as most classes are imported for the types alone
            return any(kind.__name__ == self.name for kind in type(value).__mro__)
        if self.element is not None and self.element.name in ("float", "int") and _is_row(value):
            return self.element.name == "float" or _has_whole_numbers(value)
        if not _KINDS[self.name][1](value):
            return False
        looked_at = self.element is not None and (_is_sequence(value) or isinstance(value, Mapping))  # its keys
        return not looked_at or all(map(self.element.fits_in_a_row, value))  # type: ignore[union-attr]

    def fits_in_a_row(self, value: Any) -> bool:
        """An array of one number is no element of a row: torch cannot join them."""
        return self.fits(value) and not (self.name in ("float", "int") and isinstance(value, np.ndarray))


def _is_number(value: Any) -> bool:
    if isinstance(value, (Tensor, np.ndarray)):
        return math.prod(value.shape) == 1 and not _is_odd(value)
    return isinstance(value, numbers.Real) and not isinstance(value, (bool, np.bool_))


def _has_whole_numbers(value: Tensor | np.ndarray[Any, Any]) -> bool:
    return not value.is_floating_point() if isinstance(value, Tensor) else value.dtype.kind in "iu"


def _is_whole(value: Any) -> bool:
    if isinstance(value, (Tensor, np.ndarray)):
        return _is_number(value) and _has_whole_numbers(value)
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def _is_odd(value: Tensor | np.ndarray[Any, Any]) -> bool:
    """True for a bool or complex tensor, and for an array of no numbers."""
    if isinstance(value, Tensor):
        return value.is_complex() or value.dtype == torch.bool
    return value.dtype.kind not in "fiu"


def _is_quantity(value: Any) -> bool:
    if isinstance(value, (Tensor, np.ndarray)):
        return not _is_odd(value)
    return _is_number(value) or (_is_sequence(value) and nested_shape(value) is not None)


def nested_shape(value: Any) -> tuple[int, ...] | None:
    """Shape of a number or of nested sequences of them; ``None`` where they are not as long as each other."""
    if isinstance(value, (Tensor, np.ndarray)):
        return None if _is_odd(value) else tuple(value.shape)
    if not _is_sequence(value):
        return () if _is_number(value) else None
    # torch joins no array of one number with others.
    shapes = {None if isinstance(one, np.ndarray) and not one.ndim else nested_shape(one) for one in value}
    if None in shapes or len(shapes) > 1:
        return None
    return (len(value), *(shapes.pop() if shapes else ()))  # type: ignore[misc]


def _is_row(value: Any) -> bool:
    """True for an array or a tensor of numbers in a row, which serves as a sequence of them."""
    return isinstance(value, (Tensor, np.ndarray)) and value.ndim == 1 and not _is_odd(value)


def _is_iterable(value: Any) -> bool:
    if isinstance(value, (Tensor, np.ndarray)):
        return value.ndim > 0
    return isinstance(value, Iterable) and not isinstance(value, (str, bytes))


def _is_sequence(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))


_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "None": ("None", lambda value: value is None),
    "float": ("a number", _is_number),
    "Quantity": ("a number or a tensor of real numbers", _is_quantity),
    "Nested": (
        "a tensor, an array or nested sequences of real numbers",
        lambda value: _is_quantity(value) and nested_shape(value) != (),
    ),
    "int": ("a whole number", _is_whole),
    "bool": ("True or False", lambda value: isinstance(value, (bool, np.bool_))),
    "str": ("text", lambda value: isinstance(value, str)),
    "path": ("the path of a file", lambda value: isinstance(value, (str, os.PathLike))),
    "Mapping": ("a mapping", lambda value: isinstance(value, Mapping)),
    "Sequence": ("a sequence", _is_sequence),
    "Iterable": ("a sequence", _is_iterable),
    "Callable": ("a function", callable),
    "array": ("an array of real numbers", lambda value: isinstance(value, np.ndarray) and not _is_odd(value)),
    "Tensor": ("a tensor", lambda value: isinstance(value, Tensor)),
    "real": ("a tensor of real numbers", lambda value: isinstance(value, Tensor) and not _is_odd(value)),
    "floating": (
        "a floating-point tensor",
        lambda value: isinstance(value, Tensor) and value.is_floating_point(),
    ),
    "whole": (
        "a tensor of whole numbers",
        lambda value: isinstance(value, Tensor) and not value.is_floating_point() and not _is_odd(value),
    ),
    "mask": ("a tensor of True and False", lambda value: isinstance(value, Tensor) and value.dtype == torch.bool),
}


@cache
def _declared(head: str) -> tuple[str, tuple[tuple[str, tuple[_Kind, ...]], ...]]:
    """Name of the function, and its parameters with their kinds."""
    owner, _, rest = head.partition("(")
    found = []
    for part in _parted(rest.removesuffix(")"), ","):
        name, _, kinds = part.partition(":")
        found.append((name.strip(), tuple(_kind(one.strip()) for one in _parted(kinds, "|"))))
    return owner, tuple(found)


def _kind(text: str) -> _Kind:
    found = re.fullmatch(r"(\w+)(?:\((.*)\))?(?:\[(.*)\])?", text)
    assert found is not None, text
    name, shape, element = found.groups()
    sizes = None if shape is None else tuple(one.strip() for one in shape.split(",") if one.strip())
    return _Kind(name, sizes, None if element is None else _kind(element))


def _parted(text: str, sign: str) -> list[str]:
    """Parts of a text between signs that stand in no brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "([") - (letter in ")]")
        if letter == sign and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _check_path(owner: str, name: str, path: str | bytes) -> None:
    """Refuse a name that no file can have, a null character or half a character, and what never ends."""
    try:
        name_bytes = max(map(len, os.fsencode(path).split(os.sep.encode())))
        # 255 bytes are the most of every usual file system.
        if b"\0" not in os.fsencode(path) and not isinstance(path, bytes) and name_bytes <= 255:
            check_no_device(path)
            return
    except UnicodeEncodeError:
        pass
    raise InputValueError(f"{owner}: {name} must be the name of a file; got {path!r}, which no file can have.")


def _check_shape(owner: str, name: str, shape: tuple[str, ...] | None, value: Tensor, sizes: Sizes) -> None:
    if shape is None:
        return
    found, wanted = tuple(value.shape), shape
    if wanted[:1] == ("...",):
        wanted = wanted[1:]
        found = found[len(found) - len(wanted) :] if len(found) >= len(wanted) else ()
    fits = len(found) == len(wanted) and all(
        _size_fits(size, one, sizes) for size, one in zip(found, wanted, strict=True)
    )
    if not fits:
        words = ", ".join(one.replace("+", " or more") for one in shape)
        same = [f"{one} = {sizes[one]}" for one in dict.fromkeys(shape) if one in sizes]
        raise InputValueError(
            f"{owner}: {name} must have shape ({words}{',' if len(shape) == 1 else ''})"
            f"{' with ' + ', '.join(same) if same else ''}; got {tuple(value.shape)}."
        )


def _size_fits(size: int, wanted: str, sizes: Sizes) -> bool:
    if wanted.endswith("+"):
        return size >= int(wanted[:-1])
    return size == (int(wanted) if wanted.isdigit() else sizes.setdefault(wanted, size))


def _shown(value: object) -> str:
    if isinstance(value, (Tensor, np.ndarray)):
        return f"{value.dtype} {tuple(value.shape)}"
    text = repr(value)
    return text if len(text) <= 200 else f"{text[:197]}..."
