"""Fog by compiled loops: the numbers of torch, on any number of threads, and torch where they do not reach."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.camera.depth import SceneDepth
from torchweather.core import compiled as switch

# A polynomial for exp, 2e-7 of it; the largest difference over the cases below is 1.2e-7.
SATURATION = 5e-7
HEIGHT, WIDTH = 62, 94
CAMERA = tw.Camera.from_intrinsics(60.0, 62.0, 46.5, 30.5, WIDTH, HEIGHT, pitch_rad=0.05)


def scene(*, masks: bool) -> SceneDepth:
    generator = torch.Generator().manual_seed(4)
    depth = 2 + 90 * torch.rand(1, HEIGHT, WIDTH, generator=generator)
    depth[:, :20] = torch.inf
    if not masks:
        return SceneDepth(depth, "exact")
    sky, near = torch.rand(1, HEIGHT, WIDTH, generator=generator), torch.zeros(1, HEIGHT, WIDTH)
    near[:, 50:] = torch.rand(1, 12, WIDTH, generator=generator)
    return SceneDepth(depth, "exact", sky=sky, near_mask=near)


def both(monkeypatch: pytest.MonkeyPatch, render: Callable[[], Tensor]) -> tuple[Tensor, Tensor]:
    """By compiled loops and by torch."""
    found = []
    for chosen in "10":
        monkeypatch.setenv(switch.SWITCH, chosen)
        found.append(render())
    return found[0], found[1]


def foggy(mor_m: Any, **more: Any) -> tw.BayerFog:
    return tw.BayerFog(tw.Fog(mor_m=mor_m), CAMERA, **{"airlight": (0.6, 0.7, 0.8), **more})


@pytest.mark.parametrize("masks", [False, True])
@pytest.mark.parametrize(
    "options",
    [{}, {"airlight": None}, {"airlight": "grey"}, {"layer_top_m": float("inf")}, {"layer_top_m": 3.0}],
    ids=lambda options: ", ".join(f"{key}={value}" for key, value in options.items()) or "given airlight",
)
def test_compiled_fog_is_that_of_torch(masks: bool, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(5)
    raw, rgb = (torch.rand(planes, HEIGHT, WIDTH, generator=generator) for planes in (1, 3))
    for mor_m in (20.0, 700.0):
        transform, seen = foggy(mor_m, **options), scene(masks=masks)
        for frame, render in ((raw, transform), (rgb, tw.AsBayer(transform))):
            fast, slow = both(monkeypatch, lambda frame=frame, render=render, seen=seen: render(frame, seen))
            # sRGB's slope is 12.9 at black.
            assert float((fast - slow).abs().max()) < SATURATION * (1.0 if frame is raw else 12.92)
            assert not torch.equal(fast, slow)  # two paths indeed


def test_no_fog_leaves_every_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")
    raw = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(6))
    for masks in (False, True):
        assert torch.equal(foggy(float("inf"))(raw, scene(masks=masks)), raw)


def test_threads_and_the_other_samples_leave_every_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")
    visibility = torch.tensor([30.0, float("inf"), 400.0])
    frames = torch.rand(3, 1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(7))
    depth, before = scene(masks=False), torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = foggy(visibility)(frames, depth)
        torch.set_num_threads(3)
        assert torch.equal(foggy(visibility)(frames, depth), one)
    finally:
        torch.set_num_threads(before)
    for sample, mor_m in enumerate(visibility.tolist()):
        assert torch.equal(foggy(mor_m)(frames[sample], depth), one[sample])
    assert torch.equal(one[1], frames[1])


def test_out_takes_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")
    raw = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(8))
    out = torch.empty_like(raw)
    assert torch.equal(foggy(60.0)(raw, scene(masks=True), out=out), foggy(60.0)(raw, scene(masks=True)))


def test_transmission_is_that_of_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    raw, seen = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(8)), scene(masks=False)
    for mor_m in (2.0, 60.0):
        transform = foggy(5.0 * mor_m, layer_top_m=float("inf"))
        fast, slow = both(monkeypatch, lambda transform=transform: transform.run(raw, seen).transmission)
        assert float((fast - slow).abs().max()) < SATURATION
        assert torch.equal(fast == 0, slow == 0)
        monkeypatch.setenv(switch.SWITCH, "1")
        assert torch.equal(transform.run(raw, seen).bayer, transform(raw, seen))


@pytest.mark.parametrize("what", ["double", "gradient", "multiple"])
def test_torch_computes_what_the_loops_do_not_cover(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(9))
    depth = scene(masks=False).depth_m

    def render() -> Tensor:
        if what == "double":
            return foggy(60.0)(raw.double(), depth)
        if what == "multiple":
            return foggy(60.0, scattering="multiple")(raw, depth)
        learnt = depth.clone().requires_grad_()
        return torch.autograd.grad(foggy(60.0)(raw, learnt).sum(), learnt)[0]

    fast, slow = both(monkeypatch, render)
    assert torch.equal(fast, slow)
