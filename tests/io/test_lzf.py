"""LZF: what goes in comes out, streams written by hand, and broken streams."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from torchweather.io.lzf import LZF_MAX_RATIO, lzf_compress, lzf_decompress


@pytest.mark.parametrize(
    ("stream", "plain"),
    [
        (b"", b""),
        (b"\x02abc", b"abc"),
        (b"\x00a\x20\x00", b"aaaa"),  # length 3, distance 1: overlaps itself
        (b"\x02abc\x40\x02", b"abcabca"),  # length 4, distance 3
        (b"\x00a\xe0\xff\x00", b"a" * 265),  # the longest match, 264
    ],
)
def test_streams_written_by_hand(stream: bytes, plain: bytes) -> None:
    assert bytes(lzf_decompress(stream, len(plain))) == plain


@given(
    st.one_of(
        st.binary(max_size=300),
        st.lists(st.sampled_from([b"a", b"ab", b"xyz", b"\0" * 40]), max_size=100).map(b"".join),
    )
)
@settings(max_examples=200, deadline=None)
def test_any_bytes_come_back(plain: bytes) -> None:
    packed = bytes(lzf_compress(plain))
    assert bytes(lzf_decompress(packed, len(plain))) == plain
    assert len(packed) <= len(plain) + len(plain) // 32 + 1
    assert len(plain) <= len(packed) * LZF_MAX_RATIO


def test_several_blocks_and_long_matches_come_back() -> None:
    rng = np.random.default_rng(0)
    plain = rng.integers(0, 3, 1_100_000, dtype=np.uint8).tobytes() + bytes(100_000) + rng.bytes(50_000)
    packed = bytes(lzf_compress(plain))
    assert bytes(lzf_decompress(packed, len(plain))) == plain
    assert len(packed) < 0.7 * len(plain)
    # Zeros: 3 bytes for 264, the best the format can do, within a hundredth.
    assert len(lzf_compress(bytes(100_000))) < 1.01 * 100_000 / LZF_MAX_RATIO


@pytest.mark.parametrize(
    ("stream", "size", "message"),
    [
        (b"\x05abc", 6, "instead of 6"),
        (b"\x00a\x20\x05", 4, "before its beginning"),
        (b"\x00a\xe0", 10, "ends within a match"),
        (b"\x02abc", 2, "gives 3 bytes instead of 2"),
    ],
)
def test_broken_streams_are_refused(stream: bytes, size: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        lzf_decompress(stream, size)
