"""The sensor of a command that takes one kind alone."""

from __future__ import annotations

from torchweather.core.exceptions import InputValueError

__all__ = ["preset_named"]


def preset_named(text: str | None, kind: str, wanted: str) -> str:
    """The preset in ``kind:PRESET``; empty where none is named.

    Args:
        text: of ``--sensor``; ``None`` where it was not given.
        kind: that the command takes.
        wanted: the start of the message for another kind, such as ``view: --sensor must be lidar, with :PRESET``.

    Raises:
        InputValueError: another kind.

    Example:
        >>> preset_named("lidar:ouster-os1-128", "lidar", "view: --sensor must be lidar, with :PRESET")
        'ouster-os1-128'
    """
    found, _, preset = (text or kind).partition(":")
    if found != kind:
        raise InputValueError(f"{wanted}; got {text!r}.")
    return preset
