"""Particles as a GPU renders them, by pairs of mark and pixel: the numbers of the processor's path by classes."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from tests.camera.particles.test_compiled_path import CASES, FALLEN, SATURATION, STEPS, camera_of, depth_of, inside
from torchweather.camera import srgb_bytes
from torchweather.camera.particles.population import Population
from torchweather.camera.state import CameraState


def compared(
    part: Population, state: CameraState, noise: dict[str, Tensor], fog: Tensor | None = None
) -> tuple[Tensor, ...]:
    """Optical depths of listed particles, and weighted with the fog where it is given: by pairs, then by classes."""
    table = part.in_air(state)
    pairs, classes = (one(state, noise, table, fog, lit=False) for one in (part._depth_by_pairs, part.listed_depth))
    assert pairs[0].shape == classes[0].shape
    assert (pairs[1] is None) == (classes[1] is None)
    return torch.stack([x for x in pairs if x is not None]), torch.stack([x for x in classes if x is not None])


def assert_same(pairs: Tensor, classes: Tensor) -> None:
    # Sums in another order. A share of the exposure is at most its optical depth; where that is above 1, relative.
    assert float(((pairs - classes).abs() / classes.clamp_min(1.0)).max()) < SATURATION
    assert float(classes.max()) > 100 * SATURATION


@pytest.mark.parametrize("name", CASES)
def test_pairs_give_what_classes_give(name: str) -> None:
    weather, optics, options, scene = CASES[name]
    camera = camera_of(**optics)
    transform = tw.BayerWeather(weather, camera, airlight=0.7, **options)
    state, noise, part = inside(transform, torch.full((1, camera.height, camera.width), 0.2), depth_of(camera, scene))
    assert_same(*compared(part, state, noise, torch.tensor([0.02])))


@pytest.mark.parametrize(
    "changed",
    [
        {"row_time_s": torch.tensor([2e-5])},
        {"path_tangent": torch.tensor([0.7])},
        {"particle_count": torch.tensor([2.7])},
    ],
    ids=["a rolling shutter", "a slope", "copies"],
)
def test_effects_on_particles_are_those_of_classes(changed: dict[str, Any]) -> None:
    camera = camera_of()
    transform = tw.BayerWeather(FALLEN, camera, airlight=0.7)
    frame = torch.full((1, camera.height, camera.width), 0.2)
    assert_same(*compared(*reversed_parts(inside(transform, frame, depth_of(camera, STEPS), **changed))))


def reversed_parts(found: tuple[CameraState, dict[str, Tensor], Population]) -> tuple[Any, ...]:
    state, noise, part = found
    return part, state, noise


def test_samples_of_a_batch_have_their_own_rates_and_scenes() -> None:
    camera = camera_of()
    transform = tw.BayerWeather(tw.Rain(torch.tensor([0.0, 9.0, 30.0])), camera, airlight=0.7)
    frame = torch.full((3, 1, camera.height, camera.width), 0.2)
    depth = torch.stack([depth_of(camera, kind) for kind in ("far", "steps", "near")])
    state, noise, part = inside(transform, frame, depth)
    pairs, classes = compared(part, state, noise)
    assert_same(pairs, classes)
    assert not pairs[0, 0].any()
    assert pairs[0, 1].any()
    assert pairs[0, 2].any()


def test_bytes_of_a_device_are_looked_up_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(srgb_bytes, "SAMPLES_AT_ONCE", 7)
    image = torch.arange(256, dtype=torch.uint8).reshape(1, 16, 16)
    assert len(srgb_bytes._portions(image.flatten())) == 37
    assert len(srgb_bytes._portions(image.flatten().to("meta"))) == 1
    assert torch.equal(srgb_bytes.bytes_of_light(srgb_bytes.light_of_bytes(image)), image)
