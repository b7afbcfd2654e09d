"""Damage to the bytes of a file: flips, runs, cuts, copies, splices, numbers and tokens that no writer makes."""

# ruff: noqa: E501
from __future__ import annotations

import random
import re
import struct
from collections.abc import Sequence

__all__ = ["difference", "mutate"]

# A mutation never makes a file longer than this: size itself is tested by tests.fuzz.bombs.
MOST_BYTES = 1 << 17
NUMBERS = (
    "nan", "inf", "-inf", "0", "-0", "-1", "1", "2", "3", "7", "-7.5", "1e-320", "1e38", "1e39", "1e308", "1e400", "-1e400",
    "255", "256", "65535", "65536", "2147483647", "2147483648", "-2147483648", "4294967295", "4294967296",
    "9223372036854775807", "9223372036854775808", "18446744073709551616", "99999999999999999999999999", "9" * 400,
    "0x10", "1_000", "1,5", "1e", ".", "-", "+", "1.5", "0.1", "1e-3", "00012", "٣", "²", "1e1000000000",
)  # fmt: skip
WORDS = (
    "", " ", "null", "true", "false", "[]", "{}", "[[]]", "{a: 1}", "''", '"', "'", "=1+1", "~", "<<", "*a", "&a", "!!int",
    "\x00", "\x1b[2J", "é", "\ufeff", "\u2028", "\r", "\n", "\t", ",", ";", ":", "-", "#", "%", "\\", "../x", "/dev/null",
    "a" * 300, "x", "y", "z", "NaN", "None", "kitti", "binary", "ascii", "F", "U", "I", "8", "10:30", "2020-99-99",
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_TOKEN = re.compile(rb"[^\s,:;=\[\]{}()\"']+")
_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-40, 1e30, 3e38, -3e38, float("inf"), float("-inf"), float("nan"), 1e300)
_BITS = (0, 1, 2, 7, 8, 15, 16, 31, 32, 63)


def mutate(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    """Content with one to four mutations.

    Args:
        content: of a file.
        others: files that it may be spliced with.
        pick: the random stream.
    """
    text = _is_text(content)
    for _ in range(pick.choice((1, 1, 1, 2, 2, 3, 4))):
        make = pick.choice(_TEXT if text and pick.random() < 0.8 else _BYTES)
        content = make(content, others, pick)[:MOST_BYTES]
    return content


def difference(before: bytes, after: bytes, most: int = 24) -> str:
    """Where two files differ first, for a report: ``@offset: bytes -> bytes``."""
    start = next(
        (k for k, (a, b) in enumerate(zip(before, after, strict=False)) if a != b), min(len(before), len(after))
    )
    tail = 0
    while (
        tail < min(len(before), len(after)) - start and before[len(before) - 1 - tail] == after[len(after) - 1 - tail]
    ):
        tail += 1
    old, new = before[start : len(before) - tail], after[start : len(after) - tail]
    return f"@{start}: {old[:most]!r}{'...' if len(old) > most else ''} -> {new[:most]!r}{'...' if len(new) > most else ''}"


def _is_text(content: bytes) -> bool:
    head = content[:400]
    return bool(head) and sum(32 <= byte < 127 or byte in (9, 10, 13) for byte in head) > 0.9 * len(head)


def _place(content: bytes, pick: random.Random) -> int:
    """A position; headers are short, so the beginning is met more often."""
    span = len(content) if pick.random() < 0.5 else min(len(content), 256)
    return pick.randrange(span) if span else 0


def _flip(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(pick.choice((1, 1, 2, 8))):
        if changed:
            changed[_place(content, pick)] ^= 1 << pick.randrange(8)
    return bytes(changed)


def _run(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    at, length = _place(content, pick), pick.choice((1, 2, 4, 8, 16, 64, 500))
    if pick.random() < 0.5:
        run = bytes([pick.choice((0, 1, 0x7F, 0x80, 0xFF, 0x20, pick.randrange(256)))]) * length
    else:
        run = pick.randbytes(length)
    return content[:at] + run + content[at + length :]


def _cut(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    if pick.random() < 0.6:
        return content[: pick.randrange(len(content) + 1)]
    at = _place(content, pick)
    return content[:at] + content[at + pick.choice((1, 2, 3, 4, 8, 12, 100)) :]


def _copy(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    at = _place(content, pick)
    part = content[at : at + pick.choice((1, 2, 4, 12, 60, 1000))]
    to = _place(content, pick)
    return content[:to] + part * pick.choice((1, 1, 2, 20)) + content[to:]


def _insert(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    at = _place(content, pick)
    return content[:at] + pick.randbytes(pick.choice((1, 2, 3, 4, 16, 100))) + content[at:]


def _splice(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    other = pick.choice(others) if others else content
    return content[: pick.randrange(len(content) + 1)] + other[pick.randrange(len(other) + 1) :]


def _word(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    """A binary number of 1 to 8 bytes, of either byte order, at an edge of its type."""
    at = _place(content, pick)
    order = pick.choice("<>")
    if pick.random() < 0.4:
        form = pick.choice("efd")
        try:
            new = struct.pack(order + form, pick.choice(_FLOATS))
        except OverflowError:
            new = struct.pack(order + form, float("inf"))
    else:
        size = pick.choice((1, 2, 4, 8))
        edge = (1 << min(pick.choice(_BITS), 8 * size - 1)) + pick.choice((-2, -1, 0, 1))
        value = pick.choice((edge, -edge, 0, -1, (1 << 8 * size) - 1)) & ((1 << 8 * size) - 1)
        new = value.to_bytes(size, "little" if order == "<" else "big")
    if pick.random() < 0.5:
        at -= at % len(new)
    return content[:at] + new + content[at + len(new) :]


def _number(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    """A number in text, such as one of a header, at an edge."""
    return _replace(_NUMBER, content, [word.encode() for word in NUMBERS], pick)


def _token(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    """A word in text replaced by an edge case or by another word of the same text."""
    own = [found[0] for found in _TOKEN.finditer(content[:4096])]
    words = [word.encode() for word in pick.choice((WORDS, NUMBERS))]
    return _replace(_TOKEN, content, own if own and pick.random() < 0.5 else words, pick)


def _replace(pattern: re.Pattern[bytes], content: bytes, words: Sequence[bytes], pick: random.Random) -> bytes:
    found = list(pattern.finditer(content[: 1024 if pick.random() < 0.5 else 1 << 14]))
    if not found:
        return _flip(content, (), pick)
    one = pick.choice(found)
    return content[: one.start()] + pick.choice(words) + content[one.end() :]


def _lines(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    """Lines in another order, one left out, twice, indented, or from another file."""
    lines = content.split(b"\n")
    at, to = pick.randrange(len(lines)), pick.randrange(len(lines))
    what = pick.randrange(5)
    if what == 0:
        lines[at], lines[to] = lines[to], lines[at]
    elif what == 1:
        del lines[at]
    elif what == 2:
        lines.insert(to, lines[at])
    elif what == 3:
        lines[at] = b"  " * pick.choice((1, 2, 60)) + lines[at]
    elif others:
        lines.insert(to, pick.choice(pick.choice(others).split(b"\n")))
    return b"\n".join(lines)


_BYTES = (_flip, _run, _cut, _copy, _insert, _splice, _word, _word, _number)
_TEXT = (_number, _number, _token, _token, _lines, _cut, _copy, _splice)
