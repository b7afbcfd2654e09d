"""The work on a Ray cluster, by Ray Data: actors do frames, this process alone keeps the manifest."""

from __future__ import annotations

import json
import logging
import os
import shutil
from collections.abc import Generator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from torchweather.core.errors import MissingExtraError
from torchweather.core.extras import install_hint
from torchweather.datasets.augment.frames import Frame
from torchweather.datasets.augment.job import Job
from torchweather.datasets.augment.local import TRIES, lost_row
from torchweather.datasets.augment.manifest import Row
from torchweather.datasets.augment.work import ATTEMPTS, Worker

__all__ = ["RayEngine", "check_ray"]

MOST_BLOCKS = 20_000  # that Ray Data keeps track of without effort


class RayEngine:
    """Rows of frames, in the order in which they are done.

    A cluster that this process is connected to is used, or the one that ``RAY_ADDRESS`` names, else one is begun on
    this machine and ended after the run. Source and target must be the same folders on all machines.

    Args:
        job: what to do.
        workers: actors, of one processor each.
    """

    def __init__(self, job: Job, workers: int) -> None:
        self.job, self.workers = job, workers
        self.stopping = False

    def rows(self, frames: Sequence[Frame]) -> Generator[Row, None, None]:
        """Outcome of each frame."""
        ray = _ray()
        own = not ray.is_initialized()
        if own:
            # Without an address a cluster that already runs here would be joined by accident.
            address = os.environ.get("RAY_ADDRESS") or "local"
            more = {"num_cpus": max(self.workers, 1) + 1, "include_dashboard": False} if address == "local" else {}
            ray.init(address, logging_level=logging.ERROR, log_to_driver=False, **more)
        try:
            yield from self._by_ray_data(ray, frames)
        finally:
            if own:
                ray.shutdown()

    def _by_ray_data(self, ray: Any, frames: Sequence[Frame]) -> Generator[Row, None, None]:
        context = ray.data.DataContext.get_current()
        before = (context.enable_progress_bars, context.max_errored_blocks)
        context.enable_progress_bars = False
        context.max_errored_blocks = -1  # a frame whose worker died too often: reported below
        logging.getLogger("ray.data").setLevel(logging.ERROR)
        try:
            left = dict(enumerate(frames))
            # One frame a block: what a dying worker takes with it is one frame, which Ray gives to another.
            numbers = ray.data.range(len(frames), override_num_blocks=min(len(frames), MOST_BLOCKS))
            done = numbers.map(
                _Actor,
                fn_constructor_args=(self.job, tuple(frames)),
                compute=ray.data.ActorPoolStrategy(size=min(self.workers, len(frames))),
                num_cpus=1,
            )
            for found in done.iter_rows():
                del left[found["id"]]
                yield Row(**json.loads(found["row"]))
                if self.stopping:
                    return
            for frame in left.values():
                yield lost_row(self.job, frame)
        finally:
            context.enable_progress_bars, context.max_errored_blocks = before
            shutil.rmtree(Path(self.job.target, ATTEMPTS), ignore_errors=True)


class _Actor:
    """A worker of the cluster."""

    def __init__(self, job: Job, frames: tuple[Frame, ...]) -> None:
        torch.set_num_threads(1)
        self.worker, self.frames = Worker(job), frames

    def __call__(self, item: dict[str, Any]) -> dict[str, Any]:
        frame = self.frames[item["id"]]
        # Ray tries without end what kills its worker; a mark in the folder that all see counts.
        mark = Path(self.worker.job.target, ATTEMPTS, str(item["id"]))
        mark.parent.mkdir(parents=True, exist_ok=True)
        with mark.open("ab") as file:
            file.write(b".")
        tried = mark.stat().st_size > TRIES
        row = lost_row(self.worker.job, frame) if tried else self.worker.process(frame)
        mark.unlink()
        return {"id": item["id"], "row": json.dumps(asdict(row))}


def check_ray() -> None:
    """Raise where Ray is not installed.

    Raises:
        MissingExtraError: with the command that installs it.
    """
    _ray()


def _ray() -> Any:
    # No word to anybody about the use of it, unless the user has said otherwise.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
        import ray.data
    except ImportError as error:
        raise MissingExtraError(f"--engine ray needs Ray. {install_hint('scale')}") from error
    return ray
