"""Images of the oracle numbers, rebuilt bit for bit: integer arithmetic and numpy only.

`reference(name)` gives a uint8 H x W x 3 image, `distort(reference, kind, level)` its distorted copy, `grey(image)` the
luma of the pairs marked `colour: false`. Compare `sha(image)` with the hashes in iqa_oracles.json first.
"""

import hashlib

import numpy as np

I64 = np.int64


def _rand(seed, lo, hi, shape):
    """Integers in [lo, hi): legacy MT19937 RandomState, whose stream numpy has frozen (NEP 19)."""
    return np.random.RandomState(seed).randint(lo, hi, size=shape, dtype=I64)


def _box(a, r):
    """(2r+1)^2 box mean with edge replication, rounded half up; integer in, integer out; HWC or HW."""
    n = 2 * r + 1
    p = np.pad(a.astype(I64), [(r, r), (r, r)] + [(0, 0)] * (a.ndim - 2), mode="edge")
    c = np.cumsum(p, axis=0)
    c = np.concatenate([c[n - 1 : n], c[n:] - c[:-n]], axis=0)
    c = np.cumsum(c, axis=1)
    c = np.concatenate([c[:, n - 1 : n], c[:, n:] - c[:, :-n]], axis=1)
    return (c + n * n // 2) // (n * n)


def _u8(a):
    return np.clip(a, 0, 255).astype(np.uint8)


def _tri(k, period, amp):
    """Integer triangle wave of the index array k, in [0, amp]."""
    return np.abs((k % period) * 2 - period) * amp // period


def reference(name):
    """One of the reference images, uint8 HxWx3."""
    if name == "waves":  # 256x256: ramps, triangle waves in 3 colours, rectangles
        y, x = np.mgrid[0:256, 0:256].astype(I64)
        a = np.stack(
            [
                40 + _tri(x + 2 * y, 37, 90) + x // 4,
                60 + _tri(3 * x - y + 1024, 53, 80) + y // 4,
                50 + _tri(x + y, 91, 120) + (255 - x) // 8,
            ],
            -1,
        )
        a[40:100, 60:140] = (200, 40, 40)
        a[150:220, 30:90] = (30, 60, 190)
        a[120:200, 170:240, 1] += 60
        return _u8(a)
    if name == "texture":  # 192x256: multi-octave random texture (natural-image like)
        h, w = 192, 256
        a = np.zeros((h, w, 3), I64)
        for o, cell in enumerate((64, 32, 16, 8, 4, 2)):
            g = _rand(100 + o, 0, 256, (-(-h // cell), -(-w // cell), 1)) * 3 + _rand(
                200 + o, 0, 256, (-(-h // cell), -(-w // cell), 3)
            )
            g = np.repeat(np.repeat(g, cell, 0), cell, 1)[:h, :w] // 4
            a += _box(g, cell // 2) * (cell + 4)
        return _u8(a * 5 // (4 * sum(c + 4 for c in (64, 32, 16, 8, 4, 2))) - 20)
    if name == "odd":  # 301x243 (odd sizes): checkerboard, disc, ramp, fine bars
        h, w = 301, 243
        y, x = np.mgrid[0:h, 0:w].astype(I64)
        a = np.stack(
            [60 + 120 * ((x // 13 + y // 17) % 2), 70 + 100 * ((x // 13 + y // 17) % 2), 90 + y * 100 // h], -1
        )
        d = (x - 120) ** 2 + (y - 150) ** 2
        a[d < 70**2] = (180, 120, 60)
        a[d < 30**2] = (20, 90, 40)
        a[250:290] = (np.where((x // 2) % 2, 210, 35)[250:290])[..., None]
        return _u8(_box(a, 1))
    if name == "road":  # 400x560 (downsampling factor 2): sky, road, lanes, boxes
        h, w = 512, 768
        y, x = np.mgrid[0:h, 0:w].astype(I64)
        a = np.empty((h, w, 3), I64)
        a[...] = np.stack([120 + y // 4, 150 + y // 5, 200 + 0 * y], -1)
        road = y > 260
        t = _rand(7, -14, 15, (h, w))
        a[road] = np.stack([70 + t, 70 + t, 74 + t], -1)[road]
        half = (y - 250) * 11 // 8
        for k in (-1, 0, 1):
            lane = road & (np.abs(x - 384 - k * half) * 40 < (y - 250)) & ((k != 0) | ((y // 32) % 2 == 0))
            a[lane] = (225, 222, 205)
        for i, (x0, y0, bw, bh) in enumerate(
            ((90, 210, 120, 90), (560, 190, 150, 120), (330, 235, 60, 45), (30, 120, 60, 140))
        ):
            a[y0 : y0 + bh, x0 : x0 + bw] = ((150, 30, 30), (40, 60, 120), (200, 190, 60), (50, 90, 50))[i]
            a[y0 + 8 : y0 + bh // 2, x0 + 8 : x0 + bw - 8] = (25, 30, 38)
            a[y0 + bh // 2 + 6 : y0 + bh - 8 : 4, x0 + 4 : x0 + bw - 4] //= 2
        tree = (y < 255) & (y > 90) & ((x - 480) ** 2 + 2 * (y - 170) ** 2 < 80**2)
        a[tree] = np.stack([45 + 3 * t, 95 + 4 * t, 40 + 2 * t], -1)[tree]
        return np.ascontiguousarray(_u8(_box(a, 1))[80:480, 60:620])
    raise KeyError(name)


def distort(ref, kind, level=0):
    """Distorted copy of a uint8 HxWx3 image; integer arithmetic only."""
    a = ref.astype(I64)
    h, w, _ = a.shape
    y, x = np.mgrid[0:h, 0:w].astype(I64)
    if kind == "identity":
        return ref.copy()
    if kind == "veil":  # homogeneous fog: level = transmission in 1/256
        return _u8((level * a + (256 - level) * np.array([218, 221, 226]) + 128) // 256)
    if kind == "fog":  # depth-dependent veil: transmission grows from the top row down
        t = (level + (240 - level) * y // (h - 1))[..., None]
        return _u8((t * a + (256 - t) * np.array([205, 210, 216]) + 128) // 256)
    if kind == "blur":  # two passes of a box of radius `level`
        return _u8(_box(_box(a, level), level))
    if kind == "noise":  # sum of 4 uniform integers per sample, half-width `level`
        return _u8(a + _rand(11, -level, level + 1, (4, h, w, 3)).sum(0))
    if kind == "streaks":  # rain-like: `level` slanted bright streaks, additive, half opaque
        q = np.random.RandomState(13).randint(0, 2**31 - 1, size=(level, 4), dtype=I64)
        for i in range(level):
            x0, y0, n, g = q[i, 0] % w, q[i, 1] % h, 8 + q[i, 2] % 33, 90 + q[i, 3] % 120
            k = np.arange(n, dtype=I64)
            yy, xx = y0 + k, x0 + k // 5
            m = (yy < h) & (xx < w)
            a[yy[m], xx[m]] += (255 - a[yy[m], xx[m]]) * g // 512
        return _u8(a)
    if kind == "flakes":  # snow-like: `level` opaque soft discs
        q = np.random.RandomState(17).randint(0, 2**31 - 1, size=(level, 3), dtype=I64)
        for i in range(level):
            cx, cy, r = q[i, 0] % w, q[i, 1] % h, 1 + q[i, 2] % 5
            s = np.s_[max(cy - r, 0) : cy + r + 1, max(cx - r, 0) : cx + r + 1]
            al = np.clip((r * r + r - (y[s] - cy) ** 2 - (x[s] - cx) ** 2) * 200 // (r * r + r), 0, 200)[..., None]
            a[s] = (a[s] * (256 - al) + 240 * al + 128) // 256
        return _u8(a)
    if kind == "brightness":  # additive shift with clipping
        return _u8(a + level)
    if kind == "contrast":  # about 128, level in 1/100 (60 lowers, 140 raises contrast)
        return _u8((a - 128) * level // 100 + 128)
    if kind == "shift":  # translation by `level` pixels to the right, edge replicated
        return np.ascontiguousarray(ref[:, np.maximum(np.arange(w) - level, 0)])
    raise KeyError(kind)


def grey(a):
    """uint8 HxW luma (299 R + 587 G + 114 B) / 1000, rounded half up."""
    a = a.astype(I64)
    return ((299 * a[..., 0] + 587 * a[..., 1] + 114 * a[..., 2] + 500) // 1000).astype(np.uint8)


def sha(a):
    return hashlib.sha256(np.ascontiguousarray(a).tobytes()).hexdigest()
