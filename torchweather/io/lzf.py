"""LZF, the byte compression of ``binary_compressed`` PCD files (the stream of liblzf, without its block headers)."""

from __future__ import annotations

import numpy as np

from torchweather.core.errors import InputValueError

__all__ = ["LZF_MAX_RATIO", "lzf_compress", "lzf_decompress"]

# The stream: a control byte below 32 is followed by that many + 1 literal bytes; any other holds in its upper 3 bits a
# length - 2 (7: add the next byte) and in its lower 5 bits with the following byte a distance - 1 backwards.
_MAX_LITERALS = 32
_MIN_MATCH = 3
_MAX_MATCH = 264
_MAX_DISTANCE = 8192
# Three bytes stand for at most 264: no honest file promises more.
LZF_MAX_RATIO = _MAX_MATCH / 3
# Candidates for matches are sought in pieces of this size: memory stays small and the sort in the cache.
_BLOCK_BYTES = 1 << 20


def lzf_decompress(data: bytes, size: int) -> bytearray:
    """The bytes that ``data`` stands for.

    Args:
        data: an LZF stream.
        size: number of bytes that must come out.

    Raises:
        ValueError: the stream is cut, refers to bytes before its beginning, or gives another number of bytes.

    Example:
        >>> bytes(lzf_decompress(bytes([0, 97, 0xE0, 0, 0]), 10))
        b'aaaaaaaaaa'
    """
    out = bytearray()
    position, end = 0, len(data)
    try:
        while position < end:
            control = data[position]
            position += 1
            if control < _MAX_LITERALS:
                stop = position + control + 1
                out += data[position:stop]
                position = stop
                continue
            length = control >> 5
            if length == 7:
                length += data[position]
                position += 1
            length += 2
            distance = ((control & 0x1F) << 8) + data[position] + 1
            position += 1
            start = len(out) - distance
            if start < 0:
                raise InputValueError(
                    f"byte {position - 1} of the stream refers to {-start} bytes before its beginning"
                )
            if distance >= length:
                out += out[start : start + length]
            else:  # The match overlaps what it writes: a pattern that repeats.
                pattern = out[start:]
                out += (pattern * (length // distance + 1))[:length]
    except IndexError as error:
        raise InputValueError("the stream ends within a match") from error
    if position != end or len(out) != size:
        raise InputValueError(f"the stream gives {len(out)} bytes instead of {size}")
    return out


def lzf_compress(data: bytes) -> bytearray:
    """An LZF stream that stands for ``data``; at most 1/32 longer than it, where nothing repeats.

    Greedy, with the nearest earlier place of the same three bytes: as short a stream as liblzf's, within a few
    percent, at some 5 to 10 megabytes a second.

    Example:
        >>> lzf_compress(b"aaaaaaaaaa").hex()
        '0061e00000'
    """
    out = bytearray()
    for begin in range(0, len(data), _BLOCK_BYTES):
        _compress_block(data[begin : begin + _BLOCK_BYTES], out)
    return out


def _compress_block(block: bytes, out: bytearray) -> None:
    """Append the stream of one block, which refers to no other."""
    places, lengths, distances = _matches(block)
    literal = 0  # first byte that is not in the stream yet
    for place, length, distance in zip(places, lengths, distances, strict=True):
        if place < literal:  # Within the match before.
            length -= literal - place
            if length < _MIN_MATCH:
                continue
            place = literal
        _append_literals(block, literal, place, out)
        length = min(length, _MAX_MATCH)
        high, low = divmod(distance - 1, 256)
        if length < 9:
            out += bytes((((length - 2) << 5) | high, low))
        else:
            out += bytes((0xE0 | high, length - 9, low))
        literal = place + length
    _append_literals(block, literal, len(block), out)


def _append_literals(block: bytes, begin: int, end: int, out: bytearray) -> None:
    for start in range(begin, end, _MAX_LITERALS):
        stop = min(start + _MAX_LITERALS, end)
        out.append(stop - start - 1)
        out += block[start:stop]


def _matches(block: bytes) -> tuple[list[int], list[int], list[int]]:
    """Where a match may begin, how long it goes on at the same distance, and that distance; in order of place."""
    values = np.frombuffer(block, np.uint8).astype(np.uint32)
    if values.size < _MIN_MATCH + 1:
        return [], [], []
    triples = (values[:-2] << 16) | (values[1:-1] << 8) | values[2:]
    order = np.argsort(triples, kind="stable")
    same = triples[order[1:]] == triples[order[:-1]]
    distance = np.zeros(triples.size, np.int64)  # 0: these three bytes did not occur before
    distance[order[1:]] = np.where(same, order[1:] - order[:-1], 0)
    distance[distance > _MAX_DISTANCE] = 0
    # A run of places with one distance is one match, three bytes longer at its last place; long runs are cut, so that
    # the greedy walk meets the next piece where it needs it.
    begins = np.flatnonzero((distance > 0) & (np.diff(distance, prepend=0) != 0))
    if not begins.size:
        return [], [], []
    breaks = np.flatnonzero(np.diff(distance, append=-1) != 0)  # last place of every run of equal distance
    run = breaks[np.searchsorted(breaks, begins)] - begins + _MIN_MATCH
    pieces = -(-run // _MAX_MATCH)
    number = np.arange(int(pieces.sum())) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    places = np.repeat(begins, pieces) + number * _MAX_MATCH
    lengths = np.minimum(np.repeat(run, pieces) - number * _MAX_MATCH, _MAX_MATCH)
    return places.tolist(), lengths.tolist(), np.repeat(distance[begins], pieces).tolist()
