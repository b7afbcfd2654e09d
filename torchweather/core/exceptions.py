"""Exceptions of the library. Imports nothing, so that a command can fail in a few milliseconds.

Everything that a caller can mend is a `TorchweatherError`. An unexpected ``ValueError`` or ``TypeError`` is therefore a
defect of the library, and the command line shows its traceback.
"""

from __future__ import annotations

__all__ = ["InputTypeError", "InputValueError", "MissingExtraError", "TorchweatherError", "TorchweatherWarning"]

_LONGEST = 8000  # characters of a message


# Characters that steer a terminal, C0 but tab and line feed, delete and C1: a file may be named so.
_STEERING = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\t\n"}


def _shown(text: str) -> str:
    """The text without its middle where it is too long to read, and without what a terminal cannot show."""
    if len(text) > _LONGEST:
        half = _LONGEST // 2
        text = f"{text[:half]} ... [{len(text) - 2 * half} characters left out] ... {text[-half:]}"
    # Bytes of a file's name that are no text are lone surrogates, which cannot be written anywhere.
    return text.translate(_STEERING).encode("utf-8", "backslashreplace").decode()


class TorchweatherError(Exception):
    """A broken file, recipe or study; carries the path and, where one exists, the key.

    Example:
        >>> raise TorchweatherError("depth.npy: not a depth map")
        Traceback (most recent call last):
        torchweather.core.exceptions.TorchweatherError: depth.npy: not a depth map
    """

    def __init__(self, *args: object) -> None:
        # A broken file may put itself into its error, at any length and with any characters.
        super().__init__(*(_shown(arg) if isinstance(arg, str) else arg for arg in args))


class InputValueError(TorchweatherError, ValueError):
    """An argument outside its range, of a wrong shape or in contradiction to another one."""


class InputTypeError(TorchweatherError, TypeError):
    """An argument of a wrong type, or one that is not known or missing."""


class MissingExtraError(TorchweatherError, ImportError):
    """A package of an optional extra is not installed; the message names the ``pip install`` command."""


class TorchweatherWarning(UserWarning):
    """A value outside the range in which a formula was measured, or data that contradict their description."""
