"""A run that is killed loses nothing and repeats nothing; processes and workers that die change no byte."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from multiprocessing import active_children
from pathlib import Path

import pytest

import torchweather.datasets.augment.work as work
from tests.datasets.augment.data_sets import FOG, folder, recipe, tree
from torchweather.datasets.augment import Manifest, Progress, Row, augment
from torchweather.datasets.augment.frames import Frame
from torchweather.datasets.augment.job import Job

ROOT = Path(__file__).parents[3]
BAD = "day/clouds/001.bin"

# Runs the work again and again in a child that is killed, each time later, until one comes to its end. It is forked, so
# that only one process has to import torch. Prints at which frames work was begun, and which were recorded by then.
KILLER = """
import os, random, signal, sqlite3, sys, time
from pathlib import Path
import torchweather.datasets.augment.work as work
from torchweather.datasets.augment import Manifest, augment

source, target, recipe = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
pick = random.Random(4)
process, record = work.Worker.process, Manifest.record

def recorded():
    path = target / "torchweather-manifest.sqlite"
    if not path.exists():
        return []
    with sqlite3.connect(path) as file:
        found = [name for name, in file.execute("select frame from frames where status = 'done'")]
    file.close()
    return found

augment(source, Path(sys.argv[4]), recipe, workers=0)  # also fills the tables, which the children then have

for attempt in range(200):
    print("attempt", *recorded(), flush=True)
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        def noted(self, frame):
            print("began", frame.name, flush=True)
            os.write(theirs, b".")
            return process(self, frame)
        def cut(self, row):
            if attempt % 3 == 1:  # after the files have their names, before the row is there
                os.kill(os.getpid(), signal.SIGKILL)
            record(self, row)
            if attempt % 3 == 2:
                os.kill(os.getpid(), signal.SIGKILL)
        work.Worker.process, Manifest.record = noted, cut
        try:
            augment(source, target, recipe, workers=0)
        finally:
            os._exit(0)
    os.close(theirs)
    os.read(ours, 1)  # work has begun, or the child has ended
    if attempt % 3 == 0 and attempt < 60:
        time.sleep(pick.uniform(0.0, 0.03))
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    os.close(ours)
    if os.WIFEXITED(status):
        break
print("attempt", *recorded(), flush=True)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_at_any_moment_it_loses_nothing_and_repeats_nothing(tmp_path: Path) -> None:
    source, file = folder(tmp_path / "clear", 4), recipe(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", KILLER, str(source), str(tmp_path / "killed"), file, str(tmp_path / "unbroken")],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    recorded: set[str] = set()
    attempts = 0
    for line in done.stdout.splitlines():
        what, *names = line.split()
        if what == "attempt":
            assert recorded <= set(names)  # nothing is lost
            recorded, attempts = set(names), attempts + 1
        else:
            assert names[0] not in recorded  # nothing is repeated
    assert attempts > 6  # killed twice in each of three ways
    assert len(recorded) == 5
    assert tree(tmp_path / "killed") == tree(tmp_path / "unbroken")


def test_two_workers_one_of_them_killed_give_the_bytes_of_one(tmp_path: Path) -> None:
    source, file = folder(tmp_path / "clear", 4), recipe(tmp_path)
    told: list[Progress] = []

    def kill_once(progress: Progress) -> None:
        told.append(progress)
        if progress.finished == 1:
            pid = active_children()[0].pid
            assert pid is not None
            os.kill(pid, signal.SIGKILL)

    two = augment(source, tmp_path / "two", file, workers=2, on_progress=kill_once)
    one = augment(source, tmp_path / "one", file, workers=0)
    assert (one.done, one.broken) == (two.done, two.broken) == (5, {})
    assert tree(tmp_path / "one") == tree(tmp_path / "two")
    assert [progress.finished for progress in told] == list(range(6))


def test_a_frame_that_kills_its_worker_twice_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop that looks after the workers, with stand-ins for the processes."""
    from torchweather.datasets.augment import local

    class StandIn:
        """Dies of one frame."""

        def __init__(self, job: Job) -> None:
            self.worker = work.Worker(job)
            self.ready, self.alive, self.exit_code = False, True, -9
            self.task: tuple[Frame, int] | None = None
            self.pipe = self

        def give(self, frame: Frame, tries: int) -> None:
            self.task = (frame, tries)
            tried.append(frame.name)

        def answer(self) -> Row | None:
            if not self.ready:
                self.ready = True
                return None
            if self.task is None or self.task[0].name == BAD:
                self.alive = False
                return None
            frame, self.task = self.task[0], None
            return self.worker.process(frame)

        def leave(self) -> None:
            self.alive = False

    tried: list[str] = []
    monkeypatch.setattr(local, "_Process", StandIn)
    monkeypatch.setattr(local, "wait", lambda pipes: [one for one in pipes if not one.ready or one.task][:1])
    source = folder(tmp_path / "clear", 3)
    summary = augment(source, tmp_path / "out", recipe(tmp_path, FOG), workers=1)
    assert tried.count(BAD) == 2
    assert summary.done == len(tried) - 2 == 6
    assert list(summary.broken) == [BAD]
    assert "its worker died 2 times with exit code -9" in summary.broken[BAD]


def test_a_folder_in_which_nothing_is_left_is_left_alone(tmp_path: Path) -> None:
    source = folder(tmp_path / "clear", 1)
    augment(source, tmp_path / "out", recipe(tmp_path, FOG), workers=0)
    # No process is begun where there is nothing to do.
    assert augment(source, tmp_path / "out", recipe(tmp_path, FOG), workers=3).to_do == 0
    with Manifest(tmp_path / "out") as manifest:
        assert manifest.settings()["seed"] == "0"
