"""Image scores written down from their papers, pixel by pixel, in numpy double precision, for small images.

Images are ``(C, H, W)`` in [0, 1], C = 1 or 3. Nothing here is shared with the package. Where a paper leaves the border
open, its authors' program decides: MATLAB's ``conv2(..., 'same')``, zeros around the image.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["naive_gmsd", "naive_haarpsi", "naive_mdsi", "naive_psnr", "naive_ssim", "naive_vif"]

Image = NDArray[np.float64]


def inside(image: Image, kernel: Image) -> Image:
    """Convolution where the kernel lies wholly in the image."""
    flipped = kernel[::-1, ::-1]
    rows, columns = kernel.shape
    height, width = image.shape[0] - rows + 1, image.shape[1] - columns + 1
    found = np.empty((height, width))
    for i in range(height):
        for j in range(width):
            found[i, j] = (image[i : i + rows, j : j + columns] * flipped).sum()
    return found


def same(image: Image, kernel: Image) -> Image:
    """MATLAB's ``conv2(image, kernel, 'same')``: the central part, which starts at element ``floor(K / 2)``, from 0."""
    rows, columns = kernel.shape
    whole = inside(np.pad(image, ((rows - 1, rows - 1), (columns - 1, columns - 1))), kernel)
    top, left = rows // 2, columns // 2
    return whole[top : top + image.shape[0], left : left + image.shape[1]]


def gaussian(size: int, sigma: float) -> Image:
    along = np.arange(size) - (size - 1) / 2
    kernel = np.exp(-(along[:, None] ** 2 + along[None] ** 2) / (2.0 * sigma**2))
    found: Image = kernel / kernel.sum()
    return found


def luma(image: Image) -> Image:
    """ITU-R BT.601, as MATLAB's ``rgb2gray``."""
    if len(image) == 1:
        return image[0]
    found: Image = 0.299 * image[0] + 0.587 * image[1] + 0.114 * image[2]
    return found


def halved(image: Image) -> Image:
    """Mean of 2 x 2 pixels, every other one kept."""
    return same(image, np.full((2, 2), 0.25))[::2, ::2]


def prewitt(image: Image) -> Image:
    """Gradient magnitude, Prewitt's weights over 3."""
    across = np.array([[1.0, 0.0, -1.0]] * 3) / 3.0
    found: Image = np.sqrt(same(image, across) ** 2 + same(image, across.T) ** 2)
    return found


def alike(one: Image, other: Image, constant: float) -> Image:
    found: Image = (2.0 * one * other + constant) / (one**2 + other**2 + constant)
    return found


def naive_psnr(distorted: Image, reference: Image) -> float:
    error = sum((float(x) - float(y)) ** 2 for x, y in zip(distorted.flat, reference.flat, strict=True))
    return math.inf if error == 0.0 else 10.0 * math.log10(reference.size / error)


def naive_ssim(distorted: Image, reference: Image) -> float:
    """Wang et al. 2004 at full resolution: 11 x 11 Gaussian of sigma 1.5, K1 0.01, K2 0.03; mean over the channels."""
    window = gaussian(11, 1.5)
    c1, c2 = 0.01**2, 0.03**2
    means = []
    for x, y in zip(distorted, reference, strict=True):
        mx, my = inside(x, window), inside(y, window)
        vx, vy = inside(x * x, window) - mx**2, inside(y * y, window) - my**2
        vxy = inside(x * y, window) - mx * my
        score = (2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
        means.append(score.mean())
    return float(np.mean(means))


def naive_gmsd(distorted: Image, reference: Image) -> float:
    """Xue et al. 2014: standard deviation of the gradient similarity at half the resolution, c = 170 for 0..255."""
    x, y = (prewitt(halved(255.0 * luma(image))) for image in (distorted, reference))
    return float(np.std(alike(x, y, 170.0)))


def naive_haarpsi(distorted: Image, reference: Image) -> float:
    """Reisenhofer et al. 2018: C = 30 for 0..255, alpha = 4.2, Haar wavelets of three scales, chroma if there is."""
    c, alpha = 30.0, 4.2
    # The authors' program has three digits, 0.596 -0.274 -0.322 and 0.211 -0.523 0.312: a score lower by up to 1e-4.
    yiq = np.array([[0.299, 0.587, 0.114], [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])
    channels = []
    for image in (distorted, reference):
        seen = image if len(image) == 1 else np.einsum("ij,jhw->ihw", yiq, image)
        channels.append([halved(255.0 * plane) for plane in seen])
    similarities, weights = [], []
    for turned in (False, True):
        sizes = []
        for scale in (1, 2, 3):
            wavelet = np.full((2**scale, 2**scale), 2.0**-scale)
            wavelet[: 2 ** (scale - 1)] *= -1.0
            sizes.append([np.abs(same(planes[0], wavelet.T if turned else wavelet)) for planes in channels])
        similarities.append((alike(*sizes[0], c) + alike(*sizes[1], c)) / 2.0)
        weights.append(np.maximum(*sizes[2]))
    if len(channels[0]) == 3:
        box = np.full((2, 2), 0.25)
        chroma = []
        for plane in (1, 2):
            chroma.append(alike(*(np.abs(same(planes[plane], box)) for planes in channels), c))
        similarities.append((chroma[0] + chroma[1]) / 2.0)
        weights.append((weights[0] + weights[1]) / 2.0)
    total = sum(float((w / (1.0 + np.exp(-alpha * s))).sum()) for s, w in zip(similarities, weights, strict=True))
    share = total / sum(float(w.sum()) for w in weights)
    return (math.log(share / (1.0 - share)) / alpha) ** 2


def naive_mdsi(distorted: Image, reference: Image) -> float:
    """Nafchi et al. 2016, the sum of both similarities: C1 = 140, C2 = 55, C3 = 550 for 0..255, alpha = 0.6, q = 1/4.

    For images below 384 pixels, which are not shrunk. A similarity below 0 has a complex root.
    """
    lhm = np.array([[0.2989, 0.5870, 0.1140], [0.30, 0.04, -0.35], [0.34, -0.60, 0.17]])
    (light_d, h_d, m_d), (light_r, h_r, m_r) = (
        np.einsum("ij,jhw->ihw", lhm, 255.0 * image) for image in (distorted, reference)
    )
    g_r, g_d, g_f = prewitt(light_r), prewitt(light_d), prewitt((light_r + light_d) / 2.0)
    edges = alike(g_r, g_d, 140.0) + alike(g_d, g_f, 55.0) - alike(g_r, g_f, 55.0)
    colours = (2.0 * (h_r * h_d + m_r * m_d) + 550.0) / (h_r**2 + h_d**2 + m_r**2 + m_d**2 + 550.0)
    root = (0.6 * edges + 0.4 * colours).astype(complex) ** 0.25
    return float(np.mean(np.abs(root - root.mean())) ** 0.25)


def naive_vif(distorted: Image, reference: Image) -> float:
    """Sheikh & Bovik 2006, pixel domain: four scales, windows of 17, 9, 5 and 3 pixels, noise variance 2 for 0..255."""
    x, y = (255.0 * luma(image) for image in (distorted, reference))
    noise, least = 2.0, 1e-10
    told = known = 0.0
    for scale in range(4):
        size = 2 ** (4 - scale) + 1
        window = gaussian(size, size / 5.0)
        if scale:
            x, y = inside(x, window)[::2, ::2], inside(y, window)[::2, ::2]
        mx, my = inside(x, window), inside(y, window)
        of_x, of_y = inside(x * x, window) - mx**2, inside(y * y, window) - my**2
        of_both = inside(x * y, window) - mx * my
        for vx, vy, vxy in zip(of_x.flat, of_y.flat, of_both.flat, strict=True):
            vx, vy = max(vx, 0.0), max(vy, 0.0)
            if vy < least:  # nothing to be seen in the reference
                continue
            known += math.log10(1.0 + vy / noise)
            if vx < least:  # and nothing left of it
                continue
            gain = vxy / (vy + least)
            rest = vx - gain * vxy
            if gain < 0.0:
                gain, rest = 0.0, vx
            told += math.log10(1.0 + gain**2 * vy / (max(rest, least) + noise))
    return told / known
