"""Demosaicing against a slow reference, closed forms and onnxruntime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from torchweather.image import PATTERNS, RCCB_TO_RGB, cfa_index, demosaic, mosaic

COLOUR = torch.tensor([0.2, 0.4, 0.8], dtype=torch.float64)


def malvar_by_full_convolutions(bayer: torch.Tensor, pattern: str) -> torch.Tensor:
    """The paper's figure 2 word by word: four 5 x 5 filters over the whole frame, then a choice per pixel."""
    cross = torch.tensor([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]])
    row = torch.tensor([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]])
    diagonal = torch.tensor(
        [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]
    )
    frames = bayer.reshape(-1, 1, *bayer.shape[-2:])
    padded = F.pad(frames, (2, 2, 2, 2), mode="reflect")

    def filtered(taps: torch.Tensor) -> torch.Tensor:
        return F.conv2d(padded, (taps / 8.0).to(frames)[None, None])

    index = cfa_index(*bayer.shape[-2:], pattern)
    red_row = (index == 0).any(1, keepdim=True)
    is_red, is_green, is_blue = (index == c for c in (0, 1, 2))
    from_row, from_column = filtered(row), filtered(row.T)
    green = torch.where(is_green, frames, filtered(cross))
    opposite = filtered(diagonal)
    red = torch.where(is_red, frames, torch.where(is_blue, opposite, torch.where(red_row, from_row, from_column)))
    blue = torch.where(is_blue, frames, torch.where(is_red, opposite, torch.where(red_row, from_column, from_row)))
    rgb = torch.cat([red, green, blue], 1)
    if pattern == "RCCB":
        rgb = torch.einsum("ij,njhw->nihw", torch.tensor(RCCB_TO_RGB).to(rgb), rgb)
    return rgb.reshape(*bayer.shape[:-3], 3, *bayer.shape[-2:])


def random_frame(*shape: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("method", ["malvar", "bilinear"])
@pytest.mark.parametrize("pattern", list(PATTERNS))
def test_flat_colour_survives_mosaic_and_demosaic(pattern: str, method: str) -> None:
    flat = COLOUR[:, None, None].expand(3, 8, 12)
    torch.testing.assert_close(demosaic(mosaic(flat, pattern), pattern, method), flat, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["malvar", "bilinear"])
@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_measured_colour_passes_unchanged(pattern: str, method: str) -> None:
    frame = random_frame(1, 10, 14)
    torch.testing.assert_close(mosaic(demosaic(frame, pattern, method), pattern), frame, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["malvar", "bilinear"])
@pytest.mark.parametrize("pattern", list(PATTERNS))
def test_ramps_are_interpolated_at_the_right_place(pattern: str, method: str) -> None:
    """A linear ramp per colour is exact inside the border; an interpolation half a pixel off would not be."""
    y, x = torch.meshgrid(torch.arange(12).double(), torch.arange(16).double(), indexing="ij")
    ramp = torch.stack([0.1 + 0.02 * x, 0.3 + 0.01 * y + 0.02 * x, 0.9 - 0.03 * y])
    if method == "malvar":  # its curvature terms cancel on any ramp, whatever the slopes of the colours
        ramp = torch.stack([0.1 + 0.02 * x + 0.01 * y, 0.3 + 0.01 * y - 0.03 * x, 0.9 - 0.03 * y])
    rgb = demosaic(mosaic(ramp, pattern), pattern, method)
    torch.testing.assert_close(rgb[:, 2:-2, 2:-2], ramp[:, 2:-2, 2:-2], rtol=0, atol=1e-12)


@pytest.mark.parametrize("pattern", list(PATTERNS))
@pytest.mark.parametrize("shape", [(1, 4, 4), (1, 6, 10), (2, 1, 8, 6), (2, 3, 1, 130, 8), (70, 1, 6, 6)])
def test_polyphase_malvar_equals_four_full_convolutions(pattern: str, shape: tuple[int, ...]) -> None:
    frame = random_frame(*shape)
    expected = malvar_by_full_convolutions(frame, pattern)
    torch.testing.assert_close(demosaic(frame, pattern), expected, rtol=0, atol=1e-12)
    # Single precision: about 20 products of numbers below 1, each rounded to 6e-8; RCCB triples the clear pixel.
    torch.testing.assert_close(demosaic(frame.float(), pattern), expected.float(), rtol=0, atol=1e-6)


def test_bands_with_out_equal_the_differentiable_path() -> None:
    frame = random_frame(2, 1, 150, 20)
    out = torch.empty(2, 3, 150, 20, dtype=torch.float64)
    result = demosaic(frame, "GBRG", out=out)
    assert result is out
    with_gradient = demosaic(frame.clone().requires_grad_(), "GBRG")
    assert with_gradient.requires_grad
    torch.testing.assert_close(out, with_gradient.detach(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["malvar", "bilinear"])
def test_gradient(method: str) -> None:
    frame = random_frame(1, 4, 6).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: demosaic(x, "RCCB", method), (frame,), fast_mode=True)


def test_gradient_reaches_the_colour_matrix() -> None:
    matrix = torch.tensor(RCCB_TO_RGB, dtype=torch.float64, requires_grad=True)
    frame = random_frame(1, 4, 6)
    assert torch.autograd.gradcheck(lambda m: demosaic(frame, "RCCB", matrix=m), (matrix,), fast_mode=True)


@pytest.mark.parametrize("method", ["malvar", "bilinear"])
def test_batch_equals_its_elements(method: str) -> None:
    frames = random_frame(3, 1, 8, 8, dtype=torch.float32)
    alone = torch.stack([demosaic(f, "GRBG", method) for f in frames])
    torch.testing.assert_close(demosaic(frames, "GRBG", method), alone, rtol=0, atol=1e-6)


def test_input_is_left_alone() -> None:
    frame = random_frame(1, 8, 8)
    before = frame.clone()
    for method in ("malvar", "bilinear"):
        demosaic(frame, "RGGB", method)
    assert torch.equal(frame, before)


def test_wrong_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="even"):
        demosaic(torch.zeros(1, 5, 4), "RGGB")
    with pytest.raises(ValueError, match="4 x 4 pixels or more"):
        demosaic(torch.zeros(1, 2, 4), "RGGB")
    with pytest.raises(TypeError, match="normalise"):
        demosaic(torch.zeros(1, 4, 4, dtype=torch.uint8), "RGGB")
    with pytest.raises(ValueError, match=r"one value per pixel; got \(3, 4, 4\)"):
        demosaic(torch.zeros(3, 4, 4), "RGGB")
    with pytest.raises(ValueError, match="method must be one of"):
        demosaic(torch.zeros(1, 4, 4), "RGGB", "nearest")
    with pytest.raises(ValueError, match="out must be contiguous"):
        demosaic(torch.zeros(1, 4, 4), "RGGB", out=torch.zeros(3, 4, 6))
    with pytest.raises(ValueError, match="no_grad"):
        demosaic(torch.zeros(1, 4, 4, requires_grad=True), "RGGB", out=torch.zeros(3, 4, 4))


class Malvar(torch.nn.Module):
    def forward(self, bayer: torch.Tensor) -> torch.Tensor:
        return demosaic(bayer, "RCCB")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*:DeprecationWarning", "ignore:.*:FutureWarning")
def test_malvar_runs_in_onnxruntime_at_sizes_other_than_the_traced_one(tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    half_height, half_width = torch.export.Dim("hh", min=4), torch.export.Dim("hw", min=4)
    path = tmp_path / "malvar.onnx"
    torch.onnx.export(
        Malvar().eval(),
        (torch.rand(1, 1, 12, 16),),
        str(path),
        dynamo=True,
        dynamic_shapes=({2: 2 * half_height, 3: 2 * half_width},),
        verbose=False,
    )
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    for size in ((8, 10), (20, 30)):
        frame = random_frame(1, 1, *size, dtype=torch.float32)
        (got,) = session.run(None, {name: frame.numpy()})
        np.testing.assert_allclose(got, demosaic(frame, "RCCB").numpy(), rtol=0, atol=1e-5)
