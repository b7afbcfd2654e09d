"""Work in portions on a few threads, each of which runs torch's operations alone.

Rendering is thousands of operations on arrays that fit the cache. Split over torch's own thread pool, each of them
waits at a barrier, milliseconds long where another process has the core. So portions run side by side, and every
operation on one thread.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch

__all__ = ["one_thread_an_operation", "side_by_side", "threads_at_hand"]

_lock = threading.Lock()
_outside = threading.local()  # number of threads that torch had before `one_thread_an_operation`
_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}


@contextmanager
def one_thread_an_operation() -> Iterator[None]:
    """Torch with one processor thread for each operation, for a while; ``side_by_side`` still uses all of them.

    A thread of the user's own that runs torch for the first time in this while gets one thread as well.
    """
    threads = torch.get_num_threads()
    if threads == 1:
        yield
        return
    torch.set_num_threads(1)
    _outside.threads = threads
    try:
        yield
    finally:
        _outside.threads = None
        torch.set_num_threads(threads)


def threads_at_hand() -> int:
    """Threads that ``side_by_side`` uses: those of torch outside ``one_thread_an_operation``."""
    return getattr(_outside, "threads", None) or torch.get_num_threads()


def side_by_side(tasks: Sequence[Callable[[], object]]) -> None:
    """Run tasks that write to places of their own; on as many threads as torch uses.

    Gradients do not flow out of other threads: where they are wanted, call the tasks one after the other.
    """
    threads = threads_at_hand()
    if min(threads, len(tasks)) <= 1:
        with one_thread_an_operation():
            for task in tasks:
                task()
        return
    # One share of the tasks for each thread: handing over costs more than a small task.
    for done in [_pool(threads).submit(_alone, tasks[share::threads]) for share in range(threads)]:
        done.result()


def _alone(tasks: Sequence[Callable[[], object]]) -> None:
    with torch.no_grad():
        for task in tasks:
            task()


def _pool(threads: int) -> ThreadPoolExecutor:
    """The pool of this process (threads do not survive a fork) with this number of threads."""
    key = (os.getpid(), threads)
    with _lock:
        if key not in _pools:
            present = torch.get_num_threads()
            started = threading.Barrier(threads + 1)

            def start() -> None:
                # The number of threads is a property of the thread that sets it, and the default of new ones. Torch
                # gives a thread that default on its first look, so look before setting it.
                torch.get_num_threads()
                torch.set_num_threads(1)
                started.wait()

            pool = ThreadPoolExecutor(threads, thread_name_prefix="torchweather")
            for _ in range(threads):
                pool.submit(start)
            started.wait()
            torch.set_num_threads(present)
            _pools.clear()
            _pools[key] = pool
        return _pools[key]
