"""Test processes side by side share the cores; which tests render by torch, and which by compiled functions."""

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

# Deliberate breaks of the sensors and records are of torch's path. Tests of what stands above the sensors, and of pages
# and examples, run on the compiled one, as users do: a quarter less time for the searches for a gap of a LiDAR.
# TORCHWEATHER_COMPILED runs every test on one path. The second variable tells workers what the first was.
PATH = "TORCHWEATHER_COMPILED"
PATH_OF_ALL = os.environ.setdefault("TORCHWEATHER_TESTS_COMPILED", os.environ.get(PATH, ""))
ON_COMPILED = ("tests/gap/", "tests/test_docs", "tests/test_examples.py", "tests/test_against_recordings.py")
os.environ.setdefault(PATH, "0")

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
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Each test, its fixtures and its processes on the path of its room."""
    os.environ[PATH] = PATH_OF_ALL or str(int(item.nodeid.startswith(ON_COMPILED)))
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[Any], list[Any]]:
    """A file of tests without a docstring's example is not looked through for them: a second a worker."""
    found = yield
    if TESTS not in file_path.parents or ">>>" in file_path.read_text(encoding="utf-8"):
        return found
    return [one for one in found if not isinstance(one, DoctestModule)]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Cases of many seconds beside cheaper ones of the same test are left to `-m long`."""
    left_out = listed()
    for item in items:
        if item.nodeid in left_out:
            item.add_marker(pytest.mark.long)
