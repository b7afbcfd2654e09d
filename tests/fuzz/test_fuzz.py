"""A bounded part of the fuzzers, with other seeds than the committed totals; a few inputs in every run."""

from __future__ import annotations

import json
import os

import pytest
import torch

from tests.fuzz.bombs import BOMBS, defused
from tests.fuzz.calls import fuzz_calls
from tests.fuzz.kills import killed
from tests.fuzz.readers import READERS, fuzz_reader
from tests.fuzz.targets import targets
from tests.fuzz.totals import FILE, Counts, report

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
# One of each kind of file, and cheap names of each group.
FEW_READERS = ("points-pcd", "points-ply", "points-npz", "image-png", "depth-npy", "kitti-object", "recipe", "manifest")
FEW_CALLS = ("rain_", "Fog", "Camera.", "quantise", "DepthMap", "LidarWindowLoss", "write_points")
FEW_BOMBS = ("npy", "pcd-a", "pcd-b", "ply-list", "pipe-png", "json-pose", "yaml-deep-1")


def without_fault(found: dict[str, Counts]) -> None:
    """Fail with the report where a fault was found."""
    torch.set_num_threads(1)
    assert not any(counts.faults for counts in found.values()), report(found)


def test_a_few_mutated_files() -> None:
    without_fault({name: fuzz_reader(READERS[name], 20, 1000) for name in FEW_READERS})


def test_a_few_random_calls() -> None:
    without_fault(fuzz_calls([one for one in targets() if one.name.startswith(FEW_CALLS)], 5, 1000))


def test_a_few_bombs() -> None:
    without_fault(defused(tuple(one for one in BOMBS if one.name.startswith(FEW_BOMBS))))


def test_unharmed_files_are_read() -> None:
    for name in FEW_READERS[:-1]:  # the manifests are damaged by hand already
        counts = fuzz_reader(READERS[name], 0, 0, first=-1)
        assert counts.kinds["refused"] == 0, name


def test_the_committed_totals() -> None:
    """Files, calls, bombs and kills are without fault."""
    totals = json.loads(FILE.read_text(encoding="utf-8"))
    sums = totals["sums"]
    assert sums["readers"]["number"] >= 100_000
    assert sums["calls"]["number"] >= 40_000
    for part, counts in sums.items():
        assert counts["internal"] == counts["hang"] == counts["non_finite"] == 0, part


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
def test_mutated_files(name: str) -> None:
    without_fault({name: fuzz_reader(READERS[name], 200, 2000)})


@pytest.mark.long
@pytest.mark.parametrize("group", sorted({one.group for one in targets()}))
def test_random_calls(group: str) -> None:
    without_fault(fuzz_calls([one for one in targets() if one.group == group], 10, 2000))


@pytest.mark.long
def test_bombs() -> None:
    without_fault(defused(BOMBS))


@pytest.mark.long
def test_kills() -> None:
    without_fault(killed(12, 2000))
