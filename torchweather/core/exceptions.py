"""Exceptions of the library. Imports nothing, so that a command can fail in a few milliseconds.

Everything that a caller can mend is a `TorchweatherError`. An unexpected ``ValueError`` or ``TypeError`` is therefore a
defect of the library, and the command line shows its traceback.
"""

from __future__ import annotations

__all__ = ["InputTypeError", "InputValueError", "MissingExtraError", "TorchweatherError", "TorchweatherWarning"]


class TorchweatherError(Exception):
    """A broken file, recipe or study; carries the path and, where one exists, the key.

    Example:
        >>> raise TorchweatherError("depth.npy: not a depth map")
        Traceback (most recent call last):
        torchweather.core.exceptions.TorchweatherError: depth.npy: not a depth map
    """


class InputValueError(TorchweatherError, ValueError):
    """An argument outside its range, of a wrong shape or in contradiction to another one."""


class InputTypeError(TorchweatherError, TypeError):
    """An argument of a wrong type, or one that is not known or missing."""


class MissingExtraError(TorchweatherError, ImportError):
    """A package of an optional extra is not installed; the message names the ``pip install`` command."""


class TorchweatherWarning(UserWarning):
    """A value outside the range in which a formula was measured, or data that contradict their description."""
