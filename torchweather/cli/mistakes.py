"""Errors that are the user's to mend, as one line."""

from __future__ import annotations

from torchweather.core.exceptions import TorchweatherError

__all__ = ["is_mistake", "one_line"]


def is_mistake(error: Exception) -> bool:
    """True for an error that the user can mend: what the library raises on purpose, and what the file system refuses.

    A plain ``ValueError`` or ``TypeError`` comes from a defect of the library; its traceback is shown.

    Example:
        >>> is_mistake(FileNotFoundError("depth.npy")), is_mistake(ValueError("math domain error"))
        (True, False)
    """
    return isinstance(error, (TorchweatherError, OSError))


def one_line(error: Exception) -> str:
    """Message of an error without line breaks; a missing file by its name.

    Example:
        >>> one_line(ValueError("wanted a,  got\\n b"))
        'wanted a, got b'
    """
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()).removeprefix("torchweather: ") or type(error).__name__
