"""The work on a Ray of two workers, of which one is killed: the same bytes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.datasets.augment.data_sets import folder, recipe, tree
from torchweather.datasets.augment import augment

ROOT = Path(__file__).parents[3]

# In a process of its own, which Ray's processes end with.
RUN = """
import os, signal, sys
from pathlib import Path
from torchweather.datasets.augment import augment

killed = []

def workers():
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.environ["OF_THIS_TEST"].encode() in (folder / "environ").read_bytes():
                if (folder / "cmdline").read_bytes().startswith(b"ray::MapWorker"):
                    yield int(folder.name)
        except OSError:
            pass

def kill_one(progress):
    if progress.finished == 1:
        killed.append(next(workers()))
        os.kill(killed[0], signal.SIGKILL)

summary = augment(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], workers=2, engine="ray", on_progress=kill_one)
print(len(killed), summary.done, summary.broken)
"""


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds the worker to kill in /proc")
def test_ray_with_a_worker_killed_gives_the_bytes_of_one_process(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    source, file = folder(tmp_path / "clear", 5), recipe(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(source), str(tmp_path / "ray"), file],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OF_THIS_TEST": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=500,  # 15 s on quiet cores, 100 s beside three busy programs
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "1 6 {}"
    augment(source, tmp_path / "one", file, workers=0)
    assert tree(tmp_path / "ray") == tree(tmp_path / "one")
