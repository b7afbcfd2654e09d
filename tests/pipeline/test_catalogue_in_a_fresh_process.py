"""Stages and effects are known by their names in a process that has loaded nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import torchweather as tw
from torchweather.stages import EFFECTS, STAGES

LIDAR = 'tw.Lidar.preset("velodyne-hdl-64e")'
CASES = {
    "an effect of a LiDAR": f'tw.LidarRain(tw.Rain(10), {LIDAR}, effects=[{{"effect": "lidar.window_loss", '
    '"loss_db": 1.0}])',
    "an effect of a camera": 'tw.BayerRain(tw.Rain(10), tw.Camera.preset("lucid-triton"), '
    'effects=[{"effect": "camera.defocus", "radius_px": 1.0}])',
    "an effect of a radar": 'tw.RadarAttenuation(tw.Rain(10), tw.Radar(), effects=[{"effect": "radar.wet_radome", '
    '"loss_db": 1.0}])',
}

OTHERS = [name for name in CASES if name != "an effect of a LiDAR"]  # seconds each, to load everything


def fresh(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(
    "name", ["an effect of a LiDAR", *(pytest.param(one, marks=pytest.mark.long) for one in OTHERS)]
)
def test_a_transform_takes_the_dictionary_of(name: str) -> None:
    fresh(f"import torchweather as tw\n{CASES[name]}")


def test_an_effect_is_built_from_its_dictionary() -> None:
    code = "from torchweather.pipeline.effect import effect_from_dict\n"
    code += 'print(effect_from_dict({"effect": "radar.noise_floor", "shift_db": 1.0}).id)'
    assert fresh(code) == "radar.noise_floor"


def test_a_chain_is_read_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "chain.yaml"
    tw.LidarRain(tw.Rain(10.0), tw.Lidar.preset("velodyne-hdl-64e")).chain.save(path)
    code = f"from torchweather.pipeline.chain import Chain\nprint(len(Chain.load({str(path)!r}).stages))"
    assert int(fresh(code)) > 3


@pytest.mark.parametrize(
    ("code", "number"),
    [
        pytest.param(
            "from torchweather.gap.inference.effect_forms import EFFECTS as e; print(len(e))",
            len(EFFECTS),
            marks=pytest.mark.long,
        ),
        ("from torchweather.gap.inference.forward_selection import EFFECTS as e; print(len(e))", len(EFFECTS)),
        ("from torchweather.stages import EFFECTS as e; print(len(e))", len(EFFECTS)),
        ("from torchweather.stages import STAGES as s; print(len(s))", None),
    ],
)
def test_the_catalogue_is_whole(code: str, number: int | None) -> None:
    # Other tests register stages of their own.
    assert int(fresh(code)) == number if number else int(fresh(code)) <= len(STAGES)
