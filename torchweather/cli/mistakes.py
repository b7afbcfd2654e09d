"""Errors that are the user's to mend, as one line."""

from __future__ import annotations

__all__ = ["is_mistake", "one_line"]


def is_mistake(error: Exception) -> bool:
    """Whether an error is the user's to mend and not the program's: a value, a type, a file, a missing extra."""
    from torchweather.core.errors import TorchweatherError

    return isinstance(error, (ValueError, TypeError, OSError, ImportError, TorchweatherError))


def one_line(error: Exception) -> str:
    """The message of an error without line breaks; a missing file by its name.

    Example:
        >>> one_line(ValueError("wanted a,  got\\n b"))
        'wanted a, got b'
    """
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()).removeprefix("torchweather: ") or type(error).__name__
