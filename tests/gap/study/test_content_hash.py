"""The hash of a frame: of its numbers and names, not of the machine that holds them."""

from __future__ import annotations

import numpy as np

from torchweather.gap.study.content_hash import frame_sha256


def test_byte_order_and_layout_in_memory_do_not_change_the_hash() -> None:
    numbers = np.arange(12.0).reshape(3, 4)
    little = frame_sha256({"points": numbers.astype("<f8")})
    assert frame_sha256({"points": numbers.astype(">f8")}) == little
    assert frame_sha256({"points": np.asfortranarray(numbers)}) == little


def test_names_types_and_shapes_change_the_hash() -> None:
    numbers = np.arange(12.0)
    frames = [
        {"points": numbers},
        {"beams": numbers},
        {"points": numbers.astype(np.float32)},
        {"points": numbers.reshape(3, 4)},
    ]
    assert len({frame_sha256(frame) for frame in frames}) == len(frames)
