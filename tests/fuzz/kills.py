"""Runs killed at random moments: ``python -m tests.fuzz.kills --count 100 --seed 0``.

A child is killed by SIGKILL while ``torchweather augment`` or ``apply`` is at work, and started again until it comes to
its end. Then its files must be those of a run that nobody disturbed, and at no moment does a file stand half written
under its final name.
"""

# ruff: noqa: SIM117
from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import os
import random
import shutil
import signal
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from tests.datasets.augment.data_sets import folder, kitti, recipe, tree
from tests.fuzz.outcome import Outcome
from tests.fuzz.totals import Counts, add_totals, report
from torchweather.cli import main as program

__all__ = ["killed"]


def _commands(root: Path) -> dict[str, list[str]]:
    """Command lines by name; the last word is the folder of the results."""
    clear, set_of_kitti = folder(root / "clear", 6), kitti(root / "kitti", 3)
    own = recipe(root)
    many = ["--recipe", own, "--quiet"]
    images = ["apply", str(clear / "day/images"), "--weather", "fog:mor=60", "--depth", "20", "--quiet", "--sensor"]
    images += ["camera:gopro-hero5-acdc"]
    return {
        "augment": ["augment", str(clear), *many, "--workers", "0"],
        "augment-workers": ["augment", str(clear), *many, "--workers", "2"],
        "augment-kitti": ["augment", str(set_of_kitti), *many, "--workers", "0"],
        "augment-no-fsync": ["augment", str(clear), *many, "--workers", "0", "--no-fsync"],
        "apply": [*images, "-o"],
        "apply-sequence": [*images, "--sequence", "--frame-rate-hz", "10", "-o"],
    }


def _child(arguments: Sequence[str]) -> int:
    """Start the program in a fork, which has everything imported; the number of the process."""
    pid = os.fork()
    if pid == 0:
        code = 70
        try:
            os.setsid()
            with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stderr(nowhere):
                with contextlib.redirect_stdout(io.StringIO()):
                    code = program(list(arguments))
        finally:
            os._exit(code if isinstance(code, int) else 70)
    return pid


def _end(pid: int) -> tuple[bool, int]:
    """Whether the child came to its end by itself, and its exit code."""
    _, status = os.waitpid(pid, 0)
    return os.WIFEXITED(status), os.waitstatus_to_exitcode(status)


def _half_files(target: Path, whole: dict[str, str]) -> list[str]:
    """Files under a final name that are none of those of an undisturbed run."""
    found = []
    for path in target.rglob("*"):
        name = path.relative_to(target).as_posix()
        if not path.is_file() or path.name.startswith(".") or path.name.startswith("torchweather-"):
            continue
        if hashlib.sha256(path.read_bytes()).hexdigest() != whole.get(name):
            found.append(name)
    return found


def killed(count: int, seed: int, names: Sequence[str] = ()) -> dict[str, Counts]:
    """Outcomes of ``count`` kills, by command; a value is a kill that lost nothing.

    Args:
        count: of kills that met a process at work.
        seed: of their moments.
        names: of the commands; all by default.
    """
    pick = random.Random(seed)
    found: dict[str, Counts] = {}
    with tempfile.TemporaryDirectory(prefix="fuzz-kills-") as temporary:
        root = Path(temporary)
        commands = {name: line for name, line in _commands(root).items() if not names or name in names}
        whole: dict[str, dict[str, str]] = {}
        seconds: dict[str, float] = {}
        for name, line in commands.items():
            for _ in range(2):  # the first one fills the tables of this process's file system and caches
                shutil.rmtree(root / name, ignore_errors=True)
                begin = time.monotonic()
                ended = _end(_child([*line, str(root / name)]))
                seconds[name] = time.monotonic() - begin
                assert ended == (True, 0), f"{name}: ended with {ended}"
            whole[name] = _tree(root / name)
        kills = 0
        while kills < count:
            name = list(commands)[kills % len(commands)]
            counts = found.setdefault(name, Counts())
            begin = time.monotonic()
            kills += _one_run(commands[name], root / "killed", whole[name], seconds[name], pick, counts, count - kills)
            counts.seconds += time.monotonic() - begin
    return found


def _tree(target: Path) -> dict[str, str]:
    """Files by name but records, which hold times."""
    return {name: sha for name, sha in tree(target).items() if "torchweather-" not in name}


def _one_run(
    line: Sequence[str],
    target: Path,
    whole: dict[str, str],
    seconds: float,
    pick: random.Random,
    counts: Counts,
    most: int,
) -> int:
    """Kill a run up to five times, then let it come to its end; the number of kills."""
    shutil.rmtree(target, ignore_errors=True)
    moments: list[float] = []
    while len(moments) < min(5, most):
        pid = _child([*line, str(target)])
        moment = pick.uniform(0.0, 1.1 * seconds)
        time.sleep(moment)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
        ended, code = _end(pid)
        if ended:
            break
        moments.append(moment)
        half = _half_files(target, whole) if target.is_dir() else []
        shown = f"killed after {', '.join(f'{one:.3f}' for one in moments)} s: {' '.join(line)}"
        counts.add(
            Outcome("internal", f"half a file under its final name: {half[:3]}") if half else Outcome("value"), shown
        )
    if not moments:
        return 0
    ended, code = _end(_child([*line, str(target)]))
    shown = f"killed after {', '.join(f'{one:.3f}' for one in moments)} s: {' '.join(line)}"
    if (ended, code) != (True, 0):
        counts.add(Outcome("internal", f"the run after the kill ended with {code}"), shown)
    elif (left := _tree(target)) != whole:
        odd = sorted(set(left.items()) ^ set(whole.items()))[:4]
        counts.add(Outcome("internal", f"other files than those of an undisturbed run: {odd}"), shown)
    return len(moments)


def main() -> int:
    """Run from the command line; exit code 1 where a kill lost something."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--command", action="append", help="one of the commands; all by default")
    parser.add_argument("--write", action="store_true", help="add the counts to totals.json")
    given = parser.parse_args()
    torch.set_num_threads(1)
    found = killed(given.count, given.seed, given.command or ())
    faults = report(found)
    if given.write:
        add_totals("kills", given.seed, found)
    print(f"{sum(one.kinds.total() for one in found.values())} kills, {faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    raise SystemExit(main())
