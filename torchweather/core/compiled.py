"""Functions compiled by numba, where it is installed (extra ``fast``).

numba is imported at the first use of a compiled function, never at the import of the library. Machine code is kept on
disk beside the source or, where that folder cannot be written, in the user's cache; where neither can be written it
is compiled again in every process. ``TORCHWEATHER_COMPILED=0`` leaves all work to torch.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, TypeVar

from torchweather.core.exceptions import InputValueError

__all__ = ["SWITCH", "compiled_path", "jit", "uncontracted", "uses_compiled"]

SWITCH = "TORCHWEATHER_COMPILED"
"""Environment variable that turns compiled functions off (``0``) or on (``1``, as without it)."""

F = TypeVar("F", bound=Callable[..., object])


@lru_cache
def _installed() -> bool:
    return find_spec("numba") is not None


def uses_compiled() -> bool:
    """True where numba is installed and ``TORCHWEATHER_COMPILED`` does not turn it off."""
    chosen = os.environ.get(SWITCH, "1")
    if chosen not in ("0", "1"):
        raise InputValueError(f"{SWITCH}: expected 0 or 1; got {chosen!r}. Use 0 to render with torch alone.")
    return chosen == "1" and _installed()


def compiled_path() -> str:
    """One word on the path that renders particles on the processor: ``numba``, ``torch`` and why."""
    if uses_compiled():
        return "numba"
    return f"torch ({SWITCH}=0)" if _installed() else "torch (numba, of the extra fast, is not installed)"


def jit(function: F) -> F:
    """Compile a function at its first call, once for each set of argument types.

    It runs without the interpreter's lock, so that bands of a frame run side by side. Sums keep the order of the
    source: results do not depend on the processor's vector width.
    """
    return _compiled(function, {"contract"})


def uncontracted(function: F) -> F:
    """As ``jit``, every product rounded before it is added."""
    return _compiled(function, set())


@lru_cache
def _numba() -> Any:
    """The package, with its lists of functions, which its first call would read.

    The garbage collector waits: it would go through all of torch again and again, 0.2 s of CPU.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        import numba
        from numba.core.registry import cpu_target

        cpu_target.typing_context.refresh()
        cpu_target.target_context.refresh()
    finally:
        if was_enabled:
            gc.enable()
    return numba


def _compiled(function: F, fastmath: set[str]) -> F:
    numba = _numba()
    compiler: Any = numba.njit
    options = {"nogil": True, "fastmath": fastmath, "error_model": "numpy"}
    try:
        compiled: F = compiler(cache=True, **options)(function)
    except RuntimeError:  # no folder for the cache can be written
        compiled = compiler(**options)(function)
    return compiled
