"""Mutations inside archives and pictures, whose check sums are made right again: the damage reaches the reader."""

from __future__ import annotations

import gzip
import io
import random
import struct
import warnings
import zipfile
import zlib
from collections.abc import Sequence

from tests.fuzz.mutations import mutate

__all__ = ["mutate_inside"]

_PNG = b"\x89PNG\r\n\x1a\n"


def mutate_inside(content: bytes, others: Sequence[bytes], pick: random.Random) -> bytes:
    """The content with a mutation, in half of the cases inside what it packs."""
    if pick.random() < 0.5:
        return mutate(content, others, pick)
    if content.startswith(b"PK"):
        return _archive(content, pick)
    if content.startswith(b"\x1f\x8b"):
        return gzip.compress(mutate(gzip.decompress(content), others, pick), 1, mtime=0)
    if content.startswith(_PNG):
        return _png(content, pick)
    return mutate(content, others, pick)


def _archive(content: bytes, pick: random.Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as old:
        parts = [(name, old.read(name)) for name in old.namelist()]
    at = pick.randrange(len(parts))
    name, data = parts[at]
    what = pick.randrange(6)
    if what < 3:
        parts[at] = (name, mutate(data, [one for _, one in parts], pick))
    elif what == 3:
        parts[at] = (
            pick.choice([one for one, _ in parts] + ["é.npy", "../x.npy", "a", ".npy", "x" * 300 + ".npy"]),
            data,
        )
    elif what == 4:
        del parts[at]
    else:
        parts.append((name if pick.random() < 0.5 else "more.npy", mutate(data, (), pick)))
    packed = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a name that stands twice
        with zipfile.ZipFile(packed, "w", pick.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as new:
            for one, data in parts:
                new.writestr(zipfile.ZipInfo(one), data)
    return packed.getvalue()


def _png(content: bytes, pick: random.Random) -> bytes:
    """A picture with one chunk changed."""
    chunks, at = [], len(_PNG)
    while at + 8 <= len(content):
        (length,) = struct.unpack(">I", content[at : at + 4])
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + length]))
        at += 12 + length
    which = pick.randrange(len(chunks))
    kind, data = chunks[which]
    if kind == b"IDAT" and pick.random() < 0.5:
        data = zlib.compress(mutate(zlib.decompress(data), (), pick), 1)
    elif pick.random() < 0.8:
        data = mutate(data, (), pick) if data else pick.randbytes(4)
    else:
        kind = pick.choice((b"tRNS", b"PLTE", b"eXIf", b"acTL", b"iCCP", b"gAMA", b"IDAT", b"IEND", b"tEXt", b"zTXt"))
    chunks[which] = (kind, data)
    if pick.random() < 0.2:
        chunks.insert(pick.randrange(len(chunks)), pick.choice(chunks))
    return _PNG + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
