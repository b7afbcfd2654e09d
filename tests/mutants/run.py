"""Runs mutants on a copy of the tree: each set of tests green without, red with its break."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from tests.mutants.mutant import ROOT, Mutant, missing_test
from tests.mutants.witness import TO

LIMIT_S = 600.0  # for one process of pytest: the tests of a room take under a minute, on crowded cores a few
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "dist", "build", "*.egg-info")
# A name or an import that does not exist is a slip in the mutant: a test that fails of it has noticed nothing.
SLIPS = {"SyntaxError", "IndentationError", "NameError", "UnboundLocalError", "ImportError", "ModuleNotFoundError"}
RED, GREEN = "red", "green"


@dataclass(frozen=True)
class Outcome:
    """How a mutant, or the unbroken tests of a room, ended; ``good`` where that is what was wanted."""

    name: str
    end: str
    good: bool
    seconds: float


@contextmanager
def copied_tree() -> Iterator[Path]:
    """Copy of the repository without hidden files, in a temporary directory."""
    with tempfile.TemporaryDirectory(prefix="torchweather-mutants-") as folder:
        tree = Path(folder).resolve() / "tree"
        shutil.copytree(ROOT, tree, ignore=LEFT_OUT)
        yield tree


def run_mutants(
    mutants: Sequence[Mutant], jobs: int = 1, progress: Callable[[Outcome], None] = lambda outcome: None
) -> list[Outcome]:
    """Outcome of the tests without a break, then of each mutant, in the order given."""
    complaints = [
        Outcome(mutant.name, f"{node}: {missing}", False, 0.0)
        for mutant in mutants
        for node in mutant.tests
        if (missing := missing_test(node))
    ]
    if complaints:
        return complaints
    with copied_tree() as first:
        unbroken = _unbroken(first, mutants)
        progress(unbroken)
        trees: SimpleQueue[Path] = SimpleQueue()
        trees.put(first)
        for number in range(1, jobs):
            trees.put(shutil.copytree(first, first.parent / f"tree-{number}"))

        def one(mutant: Mutant) -> Outcome:
            tree = trees.get()
            try:
                outcome = _broken(tree, mutant)
            finally:
                trees.put(tree)
            progress(outcome)
            return outcome

        with ThreadPoolExecutor(jobs) as pool:
            return [unbroken, *pool.map(one, mutants)]


def _unbroken(tree: Path, mutants: Sequence[Mutant]) -> Outcome:
    nodes = sorted({node for mutant in mutants for node in mutant.tests})
    started = time.monotonic()
    code, seen = _pytest(tree, nodes)
    bad = [node for node in nodes if not (ends := _ends_of(node, seen)) or any(e["outcome"] != "passed" for e in ends)]
    end = _wrongly_imported(tree, seen) or (f"not green: {', '.join(bad)}" if bad or code else GREEN)
    return Outcome("(no break)", end, end == GREEN, time.monotonic() - started)


def _broken(tree: Path, mutant: Mutant) -> Outcome:
    started = time.monotonic()
    try:
        broken = mutant.mutated(tree)
    except LookupError as error:
        return Outcome(mutant.name, str(error), False, 0.0)
    with _written(mutant.file(tree), broken):
        code, seen = _pytest(tree, mutant.tests)
    end = _wrongly_imported(tree, seen, mutant.module) or _end(code, seen, mutant)
    return Outcome(mutant.name, end, end.startswith(RED), time.monotonic() - started)


def _end(code: int, seen: dict, mutant: Mutant) -> str:
    """Red where every test named failed while it ran, of something else than a slip in the mutant."""
    failed = [[e for e in _ends_of(node, seen) if e["outcome"] == "failed"] for node in mutant.tests]
    errors = {e["error"] for ends in failed for e in ends}
    if code == 0:
        return "survived"
    if code != 1:
        return f"pytest ended with exit code {code}, not 1"
    if errors & SLIPS or any(e["when"] != "call" for ends in failed for e in ends):
        return f"red for the wrong reason: {', '.join(sorted(errors))}"
    green = [node for node, ends in zip(mutant.tests, failed, strict=True) if not ends]
    return f"survived in {', '.join(green)}" if green else f"{RED} ({', '.join(sorted(errors))})"


def _wrongly_imported(tree: Path, seen: dict, module: str = "torchweather") -> str | None:
    """Complaint where the tests ran on another copy of the package than the one in the tree."""
    modules: dict[str, str | None] = seen["modules"]
    if not modules:
        return "no test was run"
    outside = [name for name, file in modules.items() if file and not Path(file).is_relative_to(tree)]
    if outside:
        return f"not imported from the copy: {', '.join(sorted(outside)[:3])}"
    return None if module in modules else f"the tests do not import {module}"


def _ends_of(node: str, seen: dict) -> list[dict]:
    return [end for end in seen["ends"] if end["node"] == node or end["node"].startswith((f"{node}[", f"{node}::"))]


def _pytest(tree: Path, nodes: Sequence[str]) -> tuple[int, dict]:
    """Exit code of pytest in the tree, and what the witness saw."""
    witness = tree.parent / f"{tree.name}-witness.json"
    witness.unlink(missing_ok=True)
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", TO: str(witness)}
    environment.pop("PYTEST_ADDOPTS", None)
    # a run inside a worker of pytest-xdist: the copy is no worker of it
    for name in [name for name in environment if name.startswith("PYTEST_XDIST")]:
        del environment[name]
    plugins = ["-p", "no:xdist", "-p", "no:cacheprovider", "-p", "tests.mutants.witness"]
    options = ["-q", "--tb=no", "-o", "addopts=", "-m", "not long and not gpu and not real_data"]
    command = [sys.executable, "-m", "pytest", *options, *plugins, *nodes]
    try:
        code = subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=LIMIT_S).returncode
    except subprocess.TimeoutExpired:
        code = -1
    seen = json.loads(witness.read_text(encoding="utf-8")) if witness.exists() else {"modules": {}, "ends": []}
    return code, seen


@contextmanager
def _written(path: Path, text: str) -> Iterator[None]:
    """A file of the copy with another text, its compiled code removed before and after."""
    before = path.read_bytes()
    try:
        path.write_text(text, encoding="utf-8")
        _forget_compiled(path)
        yield
    finally:
        path.write_bytes(before)
        _forget_compiled(path)


def _forget_compiled(path: Path) -> None:
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()
