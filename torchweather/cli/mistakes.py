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
    return isinstance(error, (TorchweatherError, OSError)) or _nested_json(error)


def _nested_json(error: Exception) -> bool:
    """True where Python's JSON reader gave up on a file."""
    place = error.__traceback__ if isinstance(error, RecursionError) else None
    while place is not None:
        if place.tb_frame.f_globals.get("__name__", "").startswith("json."):
            return True
        place = place.tb_next
    return False


def one_line(error: Exception) -> str:
    """Message of an error without line breaks; a missing file by its name.

    Example:
        >>> one_line(ValueError("wanted a,  got\\n b"))
        'wanted a, got b'
    """
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if _nested_json(error):
        return "a JSON file is nested too deep; expected a file of the kind that the command reads."
    return " ".join(str(error).split()).removeprefix("torchweather: ") or type(error).__name__
