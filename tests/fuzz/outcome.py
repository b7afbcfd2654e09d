"""One call of the library, and what came of it: a value, a refusal in words, or an internal error."""

from __future__ import annotations

import dataclasses
import math
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
from torch import Tensor

from torchweather.core.errors import TorchweatherError, TorchweatherWarning

__all__ = ["HANG_S", "WAITING_S", "KINDS", "Outcome", "first_not_finite", "outcome_of"]

HANG_S = 10  # seconds of the processor: a busy machine is no hang
WAITING_S = 90  # seconds of the clock, for what waits without working
KINDS = ("value", "refused", "internal", "hang", "non_finite")
# Messages stay readable, whatever a file holds: once one had 522 million characters.
MOST_CHARACTERS = 9000


@dataclass(frozen=True)
class Outcome:
    """What came of a call.

    Args:
        kind: one of `KINDS`; the last three are faults of the library.
        where: of a fault, by which equal faults are counted together.
        detail: of a fault: the end of its traceback.
    """

    kind: str
    where: str = ""
    detail: str = ""

    @property
    def fault(self) -> bool:
        """True where the library broke its contract."""
        return self.kind not in ("value", "refused")


class _TooLong(BaseException):
    """The call takes longer than `HANG_S` or `WAITING_S`; no ``except Exception`` takes it."""


def _stop(_: int, frame: FrameType | None) -> None:
    raise _TooLong


def _watch(worked_s: int, waited_s: int) -> None:
    """Stop what comes after so many seconds of work, or of the clock; 0 and 0 let it go on."""
    signal.setitimer(signal.ITIMER_PROF, worked_s)
    signal.alarm(waited_s)


def outcome_of(call: Callable[[], Any], *, finite: bool = True, own_call: bool = False) -> Outcome:
    """Run a call and judge what comes of it.

    Args:
        call: without arguments; its value must be finite numbers where ``finite``.
        finite: whether the value's numbers must be finite.
        own_call: Python's own ``TypeError`` for the number or names of arguments is a refusal, too.
    """
    signal.signal(signal.SIGALRM, _stop)
    signal.signal(signal.SIGPROF, _stop)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        try:
            _watch(HANG_S, WAITING_S)
            value = call()
            _watch(0, 0)
        except TorchweatherError as error:
            _watch(0, 0)
            if len(text := str(error)) > MOST_CHARACTERS:
                return Outcome("internal", f"message of {len(text) // 1000},000 characters", text[:300])
            return _warned(found) or Outcome("refused")
        except _TooLong:
            return Outcome("hang", _place(sys.exc_info()[2]), traceback.format_exc(limit=-6))
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            _watch(0, 0)
            if own_call and isinstance(error, TypeError) and _by_python(error):
                return Outcome("refused")
            where = f"{type(error).__name__} {_place(error.__traceback__)}"
            return Outcome("internal", where, traceback.format_exc(limit=-6)[-MOST_CHARACTERS:])
        finally:
            _watch(0, 0)
    if finite and (at := first_not_finite(value)):
        return Outcome("non_finite", at, "")
    return _warned(found) or Outcome("value")


def _by_python(error: TypeError) -> bool:
    """True where the arguments did not fit the signature: nothing of the library was running yet."""
    frames = traceback.extract_tb(error.__traceback__)
    # Through a decorator of the library, which takes any names.
    wrapped = "no_such_argument" in str(error) and "unexpected keyword argument" in str(error)
    return wrapped or all("/tests/fuzz/" in one.filename for one in frames)


def _place(trace: Any) -> str:
    """File and line in the package where an error left it last."""
    inside = [one for one in traceback.extract_tb(trace) if "/torchweather/" in one.filename]
    if not inside:
        return "outside"
    return f"{inside[-1].filename.rpartition('/torchweather/')[2]}:{inside[-1].lineno}"


def _warned(found: Sequence[warnings.WarningMessage]) -> Outcome | None:
    """A warning that is not the package's own."""
    for one in found:
        ours = issubclass(one.category, TorchweatherWarning) or (
            issubclass(one.category, DeprecationWarning) and "torchweather" in str(one.message)
        )
        if not ours:
            where = f"{one.category.__name__} {one.filename.rpartition('/site-packages/')[2][-60:]}:{one.lineno}"
            return Outcome("internal", where, str(one.message)[:300])
    return None


def first_not_finite(value: Any, at: str = "", depth: int = 0) -> str:
    """Where the first NaN or infinity stands; empty where there is none."""
    if isinstance(value, (bool, str, bytes, int)) or value is None or depth > 6:
        return ""
    if isinstance(value, float):
        return "" if math.isfinite(value) else at or "value"
    if isinstance(value, Tensor):
        kind = value.is_floating_point() or value.is_complex()
        return (at or "tensor") if kind and not bool(value.isfinite().all()) else ""
    if isinstance(value, np.ndarray):
        return (at or "array") if value.dtype.kind in "fc" and not np.isfinite(value).all() else ""
    parts: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, Mapping):
        parts = value.items()
    elif isinstance(value, (list, tuple)):
        parts = enumerate(value)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = ((one.name, getattr(value, one.name, None)) for one in dataclasses.fields(value))
    return next((found for key, part in parts if (found := first_not_finite(part, f"{at}.{key}", depth + 1))), "")
