"""Stages and effects are known by their names in a process that has loaded nothing else."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import torchweather as tw
from torchweather.stages import EFFECTS, STAGES

ROOT = Path(__file__).parents[2]
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


pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
Fresh = Callable[[str], str]

# Loads what torchweather loads of others, seconds of it, and runs each line of code in a child of its own.
PARENT = """
import json, os, sys, traceback
import numpy, torch, torch.nn, scipy.optimize, scipy.special, scipy.stats, yaml
for line in sys.stdin:
    ours, theirs = os.pipe()
    if os.fork() == 0:
        os.dup2(theirs, 1)
        try:
            assert "torchweather" not in sys.modules
            exec(json.loads(line), {"__name__": "__main__"})
            print("and came to its end", flush=True)
        except BaseException:
            print(traceback.format_exc(), flush=True)
        os._exit(0)
    os.close(theirs)
    with os.fdopen(ours) as told:
        said = told.read()
    os.wait()
    print(json.dumps(said), flush=True)
"""


@pytest.fixture(scope="module")
def fresh() -> Iterator[Fresh]:
    """What a code prints in a process in which nothing of torchweather is loaded."""
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as parent:
        assert parent.stdin is not None
        assert parent.stdout is not None
        to, back = parent.stdin, parent.stdout

        def said(code: str) -> str:
            print(json.dumps(code), file=to, flush=True)
            printed, _, rest = str(json.loads(back.readline())).partition("and came to its end\n")
            assert not rest
            assert "Traceback" not in printed, printed
            return printed.strip()

        yield said
        to.close()


@pytest.mark.parametrize(
    "name", ["an effect of a LiDAR", *(pytest.param(one, marks=pytest.mark.long) for one in OTHERS)]
)
def test_a_transform_takes_the_dictionary_of(name: str, fresh: Fresh) -> None:
    fresh(f"import torchweather as tw\n{CASES[name]}")


def test_an_effect_is_built_from_its_dictionary(fresh: Fresh) -> None:
    code = "from torchweather.pipeline.effect import effect_from_dict\n"
    code += 'print(effect_from_dict({"effect": "radar.noise_floor", "shift_db": 1.0}).id)'
    assert fresh(code) == "radar.noise_floor"


def test_a_chain_is_read_from_its_file(tmp_path: Path, fresh: Fresh) -> None:
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
        ("from torchweather.gap.inference.effect_forms import EFFECTS as e; print(len(e))", len(EFFECTS)),
        ("from torchweather.stages import EFFECTS as e; print(len(e))", len(EFFECTS)),
        ("from torchweather.stages import STAGES as s; print(len(s))", None),
    ],
)
def test_the_catalogue_is_whole(code: str, number: int | None, fresh: Fresh) -> None:
    # Other tests register stages of their own.
    assert int(fresh(code)) == number if number else int(fresh(code)) <= len(STAGES)
