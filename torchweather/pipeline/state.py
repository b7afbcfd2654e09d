"""State of a measurement on its way through a chain: a few frozen parts, such as scene, air, signal and receiver."""

from __future__ import annotations

import warnings
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from torchweather.core.exceptions import InputTypeError

__all__ = ["PartedState"]


class PartedState:
    """A frozen dataclass of frozen parts. A field has one name, whatever the part that holds it.

    Class attributes:
        parts: name of each part to its dataclass.
        part_of: name of each field to the name of its part.
    """

    parts: ClassVar[dict[str, type[Any]]] = {}
    part_of: ClassVar[dict[str, str]] = {}

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.part_of = {one.name: part for part, kind in cls.parts.items() for one in fields(kind)}

    @classmethod
    def of(cls, **values: Any) -> Self:
        """A state from its fields, whatever their parts.

        Raises:
            TypeError: a field is not known, or one without a default is missing.
        """
        unknown = [name for name in values if name not in cls.part_of]
        if unknown:
            raise InputTypeError(f"{cls.__name__}: no field {', '.join(unknown)}")
        return cls(**{part: kind(**_own(cls.part_of, part, values)) for part, kind in cls.parts.items()})

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A field without its part, as states had it before; it goes with the next release."""
            part = type(self).part_of.get(name)
            if part is None:
                raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")
            text = f"{type(self).__name__}.{name} is .{part}.{name} now; the short form goes with the next release."
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            return self.field(name)

    def changed(self, **values: Any) -> Self:
        """The state with other values of some fields."""
        names = dict.fromkeys(self.part_of[name] for name in values)
        parts = {part: replace(getattr(self, part), **_own(self.part_of, part, values)) for part in names}
        return replace(self, **parts)  # type: ignore[type-var]

    def field(self, name: str) -> Any:
        """Value of a field."""
        return getattr(getattr(self, self.part_of[name]), name)


def _own(part_of: dict[str, str], part: str, values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if part_of[name] == part}
