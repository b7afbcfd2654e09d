"""``--exposure-control`` on images: the picture keeps its mean light."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.cli.conftest import Run
from torchweather.camera.rgb_planes import linear_planes
from torchweather.io import read_image, write_image


def mean_light(path: Path) -> float:
    return float(linear_planes(torch.as_tensor(read_image(path)[0])[None]).mean())


def test_a_picture_in_fog_keeps_its_mean_light(run: Run, tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(1)
    write_image(tmp_path / "clear.png", torch.randint(0, 200, (3, 48, 64), generator=generator, dtype=torch.uint8))
    fog = ("apply", tmp_path / "clear.png", "--weather", "fog:mor=40", "--depth", 20, "--airlight", 0.7, 0.7, 0.7)
    for name, more in (("bright", ()), ("kept", ("--exposure-control", "mean"))):
        code, _, err = run(*fog, *more, "--quiet", "-o", tmp_path / name)
        assert code == 0, err
    clear = mean_light(tmp_path / "clear.png")
    assert mean_light(tmp_path / "bright" / "clear.png") > 1.5 * clear
    assert mean_light(tmp_path / "kept" / "clear.png") == pytest.approx(clear, rel=0.02)  # rounded to 8 bits


@pytest.mark.usefixtures("undrawn")
def test_a_sweep_takes_it_and_another_word_is_refused(run: Run, tmp_path: Path) -> None:
    sweep = ("sweep", "--weather", "fog:mor=200,40", "--sensor", "camera:lucid-triton", "--size", "64x48", "--seeds", 1)
    code, _, err = run(*sweep, "--exposure-control", "median", "--metrics", "psnr", "--quiet", "-o", tmp_path / "sweep")
    assert code == 0, err
    with pytest.raises(SystemExit):
        run(*sweep, "--exposure-control", "auto", "-o", tmp_path / "sweep")
