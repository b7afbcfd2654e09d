"""The storms of a seed stay what they are, from release to release and on every machine."""

from __future__ import annotations

import json

import pytest

from tests.contract.golden_draws import PATH, summary
from tests.contract.table import TABLE
from torchweather.core.random import derived_seed, keyed_stream, sample_seed

GOLDEN = json.loads(PATH.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", list(TABLE))
def test_every_stream_of_a_transform_draws_its_golden_numbers(name: str) -> None:
    found = summary(name)
    assert list(found) == list(GOLDEN[name])
    for key, numbers in found.items():
        assert numbers == pytest.approx(GOLDEN[name][key], rel=1e-6, abs=1e-9), key


@pytest.mark.parametrize(
    ("seed", "stream", "uniform", "normal", "exponential"),
    [
        (0, "air.wave", 0.16465598748756838, -0.6143605287118722, 0.8322188623649226),
        (7, "particle_returns.hit", 0.8596917689145608, -0.6366037635892761, 1.1328961186289157),
        (2**63 - 1, "particle_veil.haze", 0.6484186015404158, -0.28764460726901, 2.905052635288903),
    ],
)
def test_a_stream_is_pinned(seed: int, stream: str, uniform: float, normal: float, exponential: float) -> None:
    assert keyed_stream(seed, stream).random() == uniform
    assert keyed_stream(seed, stream).standard_normal() == pytest.approx(normal, rel=1e-12)
    assert keyed_stream(seed, stream).standard_exponential() == pytest.approx(exponential, rel=1e-12)


def test_seeds_of_samples_and_parts_are_pinned() -> None:
    assert sample_seed(0, 0) == 1773231489816917165
    assert sample_seed(7, "000042") == 8244950142964795887
    assert sample_seed(7, 42, epoch=3) == 7023972245452084950
    assert derived_seed(7, "lidar") == 8003419583220852712
