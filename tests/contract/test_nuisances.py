"""Every transform with an effect that is yet to be drawn: batches are their samples, seeds decide, noise is refused."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from tests.contract.table import ONE_EACH, TABLE, Entry, same_bits, same_result, tensors_of
from torchweather import Uniform

# By the sensor: an effect that changes the data, at a parameter that is drawn.
DRAWN = {
    "camera": {"effect": "camera.exposure_gain", "factor": Uniform(0.5, 0.9)},
    "lidar": {"effect": "lidar.window_loss", "loss_db": Uniform(0.5, 6.0)},
    "radar": {"effect": "radar.noise_floor", "shift_db": Uniform(0.5, 6.0)},
}


def inner(transform: Any) -> Any:
    """The transform, or the one inside ``AsBayer``."""
    return getattr(transform, "transform", transform)


@pytest.fixture(params=ONE_EACH)
def drawing(request: pytest.FixtureRequest) -> tuple[Entry, Any]:
    """An entry of the table, and its transform with a nuisance."""
    entry = TABLE[request.param]
    kind = inner(entry.built()).sensor_class.kind
    return entry, entry.built(effects=[DRAWN[kind]])


def test_a_batch_with_nuisances_is_its_samples(drawing: tuple[Entry, Any]) -> None:
    entry, transform = drawing
    given, beside = entry.data(2), entry.beside(2)
    together = transform.run(given, seed=5, **beside)
    assert same_bits(transform(given, seed=5, **beside), next(iter(tensors_of(together).values())))
    assert same_result(transform.run(given, seed=torch.tensor([5, 6]), **beside), together)
    for place in range(2):
        own = {key: value[place] for key, value in beside.items()}
        alone = tensors_of(transform.run(given[place], seed=5 + place, **own))
        assert [key for key, value in tensors_of(together).items() if not same_bits(value[place], alone[key])] == []


def test_the_seed_decides_and_noise_of_no_draw_is_refused(drawing: tuple[Entry, Any]) -> None:
    entry, transform = drawing
    built = [inner(transform).at_call((), seed, None)[0].chain.to_dict() for seed in (1, 1, 2)]
    assert built[0] == built[1] != built[2]
    with pytest.raises(ValueError, match=r"effects\..* must be a value here; got Uniform"):
        transform(entry.data(), noise=transform.draw(entry.data(), seed=1))
    if transform.data_shape == ("N", "4 or more") or inner(transform) is not transform:  # maps take no empty batch
        assert transform(entry.data(0)).numel() == 0
