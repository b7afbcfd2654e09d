"""Tables of sRGB against its transfer function in double precision (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np
import torch

from torchweather.camera.srgb_bytes import byte_limits, bytes_of_light, light_of_bytes
from torchweather.image import srgb_decode

LEVELS = torch.arange(256, dtype=torch.uint8)


def test_every_level_comes_back_as_it_was() -> None:
    assert torch.equal(light_of_bytes(LEVELS), srgb_decode(LEVELS.float() / 255.0))
    assert torch.equal(bytes_of_light(light_of_bytes(LEVELS)), LEVELS)


def test_levels_are_the_nearest_of_the_transfer_function() -> None:
    light = torch.cat([torch.linspace(-0.1, 1.1, 200_001), torch.rand(50_000) * 0.02])
    exact = light.double().clamp(0.0, 1.0).numpy()
    display = np.where(exact <= 0.0031308, 12.92 * exact, 1.055 * exact ** (1 / 2.4) - 0.055)
    off = np.abs(bytes_of_light(light).numpy() - 255.0 * display)
    # The two pieces of the curve meet within 3e-8, and 1e-6 of a level is the rounding of the reference.
    assert off.max() <= 0.5 + 1e-5
    edges = torch.tensor([-torch.inf, -1.0, 0.0, 1.0, 7.0, torch.inf])
    assert bytes_of_light(edges).tolist() == [0, 0, 0, 255, 255, 255]


def test_levels_begin_at_their_limits_to_the_last_bit() -> None:
    begins = byte_limits(torch.device("cpu"))[1]
    limits = torch.unique(begins[torch.isfinite(begins)])
    assert torch.equal(bytes_of_light(limits), LEVELS[1:])
    assert torch.equal(bytes_of_light(torch.nextafter(limits, torch.zeros(()))), LEVELS[:-1])
    assert torch.equal(bytes_of_light(limits.double()), LEVELS[1:])


def test_images_of_several_portions_and_any_layout() -> None:
    image = torch.randint(0, 256, (2, 3, 151, 203), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)
    turned = image.transpose(-1, -2)
    assert torch.equal(light_of_bytes(turned), light_of_bytes(LEVELS)[turned.long()])
    assert torch.equal(bytes_of_light(light_of_bytes(image).transpose(-1, -2)), turned)
