"""Numbered work in a child process that may die, hang or run out of memory; each of these costs one number."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import select
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict

from tests.fuzz.outcome import WAITING_S, Outcome

__all__ = ["watched"]

_PER_CHILD = 5000


def watched(
    work: Callable[[int], Outcome], numbers: Sequence[int], memory_bytes: int = 2 << 30
) -> Iterator[tuple[int, Outcome]]:
    """The outcome of each number.

    Args:
        work: answers one number; runs in a forked child with a limit of its address space.
        numbers: in order.
        memory_bytes: address space above that of the process when it begins.
    """
    at = 0
    while at < len(numbers):
        part = numbers[at : at + _PER_CHILD]
        done = 0
        for outcome in _child(work, part, memory_bytes):
            yield part[done], outcome
            done += 1
        at += done


def _child(work: Callable[[int], Outcome], numbers: Sequence[int], memory_bytes: int) -> Iterator[Outcome]:
    """Outcomes of a child, the last one a death or a hang where it did not come to its end."""
    ours, theirs = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ours)
        _run(work, numbers, theirs, memory_bytes)
    os.close(theirs)
    done, rest = 0, b""
    try:
        while done < len(numbers):
            ready, _, _ = select.select([ours], [], [], 2 * WAITING_S)
            if not ready:
                os.kill(pid, signal.SIGKILL)
                yield Outcome("hang", "no answer at all", "the child was killed")
                return
            more = os.read(ours, 1 << 16)
            if not more:
                _, status = os.waitpid(pid, 0)
                pid = 0
                yield Outcome("internal", f"the process died, status {status}", "")
                return
            *lines, rest = (rest + more).split(b"\n")
            for line in lines:
                done += 1
                yield Outcome(**json.loads(line))
    finally:
        os.close(ours)
        if pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)


def _run(work: Callable[[int], Outcome], numbers: Sequence[int], theirs: int, memory_bytes: int) -> None:
    """The child's part; it never comes back. Libraries in C and Rust write to its standard error as they like."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    loud = os.dup(2)
    os.dup2(nowhere, 2)
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            size = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + memory_bytes, resource.RLIM_INFINITY))
        for number in numbers:
            line = json.dumps(asdict(work(number))) + "\n"
            left = line.encode()
            while left:
                left = left[os.write(theirs, left) :]
    except BaseException:
        os.dup2(loud, 2)
        traceback.print_exc()
    finally:
        os._exit(0)
