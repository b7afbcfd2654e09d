"""What `import torchweather` offers, and that it costs nothing before it is used."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import pytest

import torchweather
from tests.public_names import MODULES, names_of, written


def test_importing_the_library_does_not_import_torch() -> None:
    code = "import sys, torchweather; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_lidars_first_call_imports_nothing_for_graphs() -> None:
    # sympy comes with torch.broadcast_shapes, torch.onnx with a look whether it is exporting: 0.7 s together.
    code = """
import sys
import torch
import torchweather as tw
tw.LidarRain(tw.Rain(10.0), tw.Lidar.preset("velodyne-vlp-16"))(torch.tensor([[9.0, 1.0, 0.5, 40.0]]), seed=1)
print([name for name in ("sympy", "torch.onnx") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


PARTS = (
    "export",
    "gap",
    "image",
    "io",
    "metrics",
    "physics",
    "radar",
    "robustness",
    "scenes",
    "stages",
    "sweep",
    "transforms",
)


@pytest.fixture(scope="module")
def new_process() -> tuple[set[str], list[str]]:
    """Top-level packages loaded with a transform, and the parts as they are named: in one process, as torch takes the
    time."""
    # Each part as the first of a library that is loaded anew.
    code = f"""
import json, sys
from torchweather import BayerRain, Camera, Rain
loaded = sorted({{name.split(".")[0] for name in sys.modules}})
parts = []
for part in {PARTS}:
    for name in [name for name in sys.modules if name.split(".")[0] == "torchweather"]:
        del sys.modules[name]
    import torchweather
    assert not [name for name in sys.modules if name.startswith("torchweather.")], part
    parts.append(getattr(torchweather, part).__name__)
print(json.dumps([loaded, parts]))
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    loaded, parts = json.loads(done.stdout)
    return set(loaded), parts


def test_the_transforms_load_no_plots_and_no_graphs(new_process: tuple[set[str], list[str]]) -> None:
    assert not new_process[0] & {"matplotlib", "jinja2", "onnx", "onnxruntime", "torchvision"}


def test_parts_are_reached_without_an_import_of_their_own(new_process: tuple[set[str], list[str]]) -> None:
    assert new_process[1] == [f"torchweather.{part}" for part in PARTS]


def test_every_public_name_is_there_and_unknown_ones_are_refused() -> None:
    for name in torchweather.__all__:
        assert getattr(torchweather, name) is not None
    with pytest.raises(AttributeError, match="LidarRian"):
        _ = torchweather.LidarRian


@pytest.mark.parametrize("module", list(MODULES))
def test_the_public_names_are_those_of_the_page(module: str) -> None:
    """After a change: ``python -m tests.public_names``, a line in CHANGELOG.md, and an old name where one goes."""
    assert written()[module] == names_of(module)


def test_every_public_name_exists() -> None:
    assert list(written()) == list(MODULES)
    for module, names in written().items():
        for name in names:
            assert hasattr(importlib.import_module(module), name), f"{module}.{name}"
