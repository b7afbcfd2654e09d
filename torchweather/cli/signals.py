"""Ends asked for by the system: SIGTERM and SIGHUP drain a run as Ctrl-C does."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

__all__ = ["Terminated", "code_of", "signals_drain"]

# Sent by SLURM at the end of the time, by Kubernetes to a pod that has to go, by a terminal that closes.
NAMES = ("SIGTERM", "SIGHUP")
SHELL = 128  # and the signal's number: the shell's convention


class Terminated(KeyboardInterrupt):
    """An end that a signal asks for; what catches Ctrl-C catches it.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def code_of(end: KeyboardInterrupt) -> int:
    """The exit code: 130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP."""
    return SHELL + (end.number if isinstance(end, Terminated) else signal.SIGINT)


@contextmanager
def signals_drain() -> Iterator[None]:
    """Within the block the signals raise `Terminated`; one that is ignored, as under ``nohup``, stays so."""
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in NAMES:
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            if number is not None and signal.getsignal(number) == signal.SIG_DFL:
                before[number] = signal.signal(number, _raise)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _raise(number: int, frame: FrameType | None) -> None:
    raise Terminated(number)
