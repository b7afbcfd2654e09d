"""Sums over bins by sparse matrices against plain loops."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchweather.gap.sensors.camera.bins import Binned

FRAMES, ELEMENTS = 3, 200


@pytest.mark.parametrize("portions", [1, 4])
def test_sums_and_counts_are_those_of_plain_loops(portions: int) -> None:
    rng = np.random.default_rng(2)
    groups = {("one", "x"): 5, ("other", "y"): 3}
    place = {key: rng.integers(-1, count, ELEMENTS) for key, count in groups.items()}
    values = rng.normal(size=(ELEMENTS, FRAMES)).astype(np.float32)
    portion = rng.integers(0, portions, ELEMENTS)
    sums, counts = np.zeros((FRAMES * portions, 8)), np.zeros((portions, 8))
    for start, key in ((0, ("one", "x")), (5, ("other", "y"))):
        for element, own in enumerate(place[key]):
            if own < 0:
                continue
            counts[portion[element], start + own] += 1
            for frame in range(FRAMES):
                sums[frame * portions + portion[element], start + own] += values[element, frame]
    binned = Binned({key: (torch.from_numpy(place[key]), count) for key, count in groups.items()})
    assert binned.place == {("one", "x"): slice(0, 5), ("other", "y"): slice(5, 8)}
    whose = None if portions == 1 else torch.from_numpy(portion)
    np.testing.assert_allclose(binned.sums(torch.from_numpy(values), whose, portions), sums, atol=1e-5)
    np.testing.assert_array_equal(binned.counts(whose, portions), counts)
