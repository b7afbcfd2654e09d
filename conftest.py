"""Test processes side by side share the cores; torch renders particles, but in tests of the compiled path."""

from __future__ import annotations

import os
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from _pytest.doctest import DoctestModule

from tests.long_cases import listed

TESTS = Path(__file__).parent / "tests"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # read as numpy is loaded

# Deliberate breaks and records are of torch's path. TORCHWEATHER_COMPILED=1 runs every test on the compiled one. From a
# fresh clone that compiles in every worker: tests/gap took 247 processor seconds so, and 194 by torch.
os.environ.setdefault("TORCHWEATHER_COMPILED", "0")

# Compile each module once, not in every worker and every process that a test starts.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

if "PYTEST_XDIST_WORKER" in os.environ:
    torch.set_num_threads(max(1, (os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])))


def pytest_configure(config: pytest.Config) -> None:
    """Before the processes are started: linear algebra of each on the cores that it has."""
    workers = getattr(config.option, "tx", None)
    if workers:
        for name in THREADS:
            os.environ.setdefault(name, str(max(1, (os.cpu_count() or 1) // len(workers))))
        os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # a thread that waits leaves its core to the other process


@pytest.fixture(autouse=True, scope="session")
def _no_wait_for_the_disk() -> Iterator[None]:
    """Files of tests need not outlast a power cut: 6 ms for each of some thousands."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[Any], list[Any]]:
    """A file of tests without a docstring's example is not looked through for them: a second a worker."""
    found = yield
    if TESTS not in file_path.parents or file_path.suffix != ".py" or ">>>" in file_path.read_text(encoding="utf-8"):
        return found
    return [one for one in found if not isinstance(one, DoctestModule)]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Cases of many seconds beside cheaper ones of the same test are left to `-m long`."""
    left_out = listed()
    for item in items:
        if item.nodeid in left_out:
            item.add_marker(pytest.mark.long)
