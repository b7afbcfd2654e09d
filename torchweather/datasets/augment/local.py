"""The work on this machine: in this process, or in processes of its own with one torch thread each."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any

import torch

import torchweather
from torchweather.core.errors import TorchweatherError
from torchweather.core.random import sample_seed
from torchweather.datasets.augment.frame_recipe import text_sha256
from torchweather.datasets.augment.frames import COPY, Frame
from torchweather.datasets.augment.job import Job
from torchweather.datasets.augment.manifest import FAILED, Row
from torchweather.datasets.augment.work import Worker

__all__ = ["LocalEngine", "lost_row"]

TRIES = 2  # of a frame whose worker died
STARTS = 3  # workers in a row that die before their first frame
PATIENCE_S = 30.0  # for a worker to leave when there is no more to do


class LocalEngine:
    """Rows of frames, in the order in which they are done.

    Args:
        job: what to do.
        workers: processes; 0 does the work in this one.
    """

    def __init__(self, job: Job, workers: int) -> None:
        self.job, self.workers = job, workers
        self.stopping = False
        """Set to have no more frames begun; those that are under way still come."""

    def rows(self, frames: Sequence[Frame]) -> Generator[Row, None, None]:
        """Outcome of each frame."""
        if self.workers == 0:
            yield from self._here(frames)
        else:
            yield from self._elsewhere(frames)

    def _here(self, frames: Sequence[Frame]) -> Generator[Row, None, None]:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            worker = Worker(self.job)
            for frame in frames:
                if self.stopping:
                    return
                yield worker.process(frame)
        finally:
            torch.set_num_threads(threads)

    def _elsewhere(self, frames: Sequence[Frame]) -> Generator[Row, None, None]:
        waiting = deque((frame, 1) for frame in frames)
        team = [_Process(self.job) for _ in range(min(self.workers, len(waiting)))]
        fallen = 0
        interrupted: KeyboardInterrupt | None = None
        try:
            while (waiting and not self.stopping) or any(one.task for one in team):
                try:
                    for one in team:
                        if one.ready and not one.task and waiting and not self.stopping:
                            one.give(*waiting.popleft())
                    ready = wait([one.pipe for one in team])
                except KeyboardInterrupt as error:
                    if self.stopping:
                        raise
                    self.stopping, interrupted = True, error
                    continue
                for place, one in enumerate(team):
                    if one.pipe not in ready:
                        continue
                    row = one.answer()
                    if row is not None:
                        yield row
                    elif one.ready and one.alive:
                        fallen = 0
                    else:
                        fallen = 0 if one.ready else fallen + 1
                        if fallen == STARTS:
                            raise TorchweatherError("augment: the worker processes die before their first frame.")
                        if one.task:
                            frame, tries = one.task
                            if tries < TRIES:
                                waiting.appendleft((frame, tries + 1))
                            else:
                                yield lost_row(self.job, frame, one.exit_code)
                        one.leave()
                        team[place] = _Process(self.job)
        finally:
            for one in team:
                one.leave()
        if interrupted is not None:
            raise interrupted


class _Process:
    """A worker, and the frame that it has."""

    def __init__(self, job: Job) -> None:
        # Spawned, not forked: torch's threads do not survive a fork.
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(job, theirs), daemon=True)
        self.process.start()
        theirs.close()  # so that its end is seen, here as there
        self.ready = False
        self.alive = True
        self.task: tuple[Frame, int] | None = None

    @property
    def exit_code(self) -> int | None:
        """Of a process that has ended; -9 was killed."""
        self.process.join(PATIENCE_S)
        return self.process.exitcode

    def give(self, frame: Frame, tries: int) -> None:
        """Have a frame done."""
        self.task = (frame, tries)
        with contextlib.suppress(OSError):  # it has died, which is seen at the next look
            self.pipe.send(frame)

    def answer(self) -> Row | None:
        """The row of its frame; ``None`` where it has just got ready, or has died."""
        try:
            found: Row | None = self.pipe.recv()
        except (EOFError, OSError):
            self.alive = False
            return None
        if found is None:
            self.ready = True
        else:
            self.task = None
        return found

    def leave(self) -> None:
        """Have it end when its frame is done."""
        self.pipe.close()
        self.process.join(PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()  # it does not hear SIGTERM
            self.process.join(PATIENCE_S)


def _serve(job: Job, pipe: Connection[Any, Any]) -> None:
    """A worker's life: it ends when the other end of its pipe is closed."""
    # A terminal sends Ctrl-C to all, SLURM SIGTERM; the one that keeps the manifest decides.
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    torch.set_num_threads(1)
    worker = Worker(job)
    try:
        pipe.send(None)
        while True:
            pipe.send(worker.process(pipe.recv()))
    except (EOFError, OSError):
        return


def _end_with_parent() -> None:
    """End in the middle of a frame when the process that keeps the manifest is killed.

    A worker that lived on would meet the next run in the same folder, and could delete what that run has written.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def lost_row(job: Job, frame: Frame, exit_code: int | None = None) -> Row:
    """The row of a frame whose worker died each time."""
    why = "" if exit_code is None else f" with exit code {exit_code}"
    return Row(
        frame=frame.name,
        status=FAILED,
        kind=COPY if frame.is_copy else "weather",
        inputs={},
        outputs={},
        recipe_sha256=text_sha256(job.recipe),
        seed=sample_seed(job.seed, frame.seed_name, 0),
        version=torchweather.__version__,
        error=f"{frame.files[0].path}: its worker died {TRIES} times{why}; out of memory, perhaps?",
    )
