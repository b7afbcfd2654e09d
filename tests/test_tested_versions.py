"""The versions that pyproject.toml promises are those that `.ci/versions` installed and tested, by its last results."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import json
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
RESULTS = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((ROOT / ".ci" / "results").glob("*.json"))]
pytestmark = pytest.mark.skipif(
    not (ROOT / ".ci").is_dir(), reason="no .ci here (it is not part of the source distribution)"
)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("versions_script", str(ROOT / ".ci" / "versions"))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module


def result_of(mode: str) -> dict[str, Any]:
    (found,) = [result for result in RESULTS if result["mode"] == mode]
    return found


def test_every_committed_run_passed() -> None:
    assert RESULTS
    for result in RESULTS:
        assert result["failed"] == 0, result["failed_tests"]
        assert result["passed"] > (0 if result["mode"] == "lowest-export" else 1000)


@pytest.mark.parametrize("mode", ["lowest", "lowest-export"])
def test_every_lower_bound_was_installed_and_tested(script: ModuleType, mode: str) -> None:
    tested, bounds = result_of(mode)["versions"], script.lowest_versions(PROJECT, script.left_out_extras(mode))
    assert {"torch", "pytest-xdist", "hatchling"} <= set(bounds)
    untested = {
        name: (bound, tested.get(name))
        for name, bound in bounds.items()
        if name not in tested or script.release(tested[name]) != script.release(bound)
    }
    assert not untested, f"bounds that no run has tested; run .ci/versions {mode}"


def test_the_lowest_python_was_tested_with_the_lowest_versions() -> None:
    for mode in ("lowest", "lowest-export"):
        lowest = ".".join(result_of(mode)["python"].split(".")[:2])
        assert PROJECT["project"]["requires-python"] == f">={lowest}"


def project(*dependencies: str, **extras: list[str]) -> dict[str, Any]:
    named = {"name": "torchweather", "dependencies": list(dependencies), "optional-dependencies": {"dev": [], **extras}}
    return {"project": named, "build-system": {"requires": ["hatchling>=1.2"]}}


def test_bounds_are_those_of_the_build_the_package_and_the_extras_that_dev_names(script: ModuleType) -> None:
    asked = project(
        "PyYAML>=6.0", dev=["torchweather[one,two]", "types-PyYAML"], one=["ray[data]>=2.51"], two=[], view=["x>=1"]
    )
    assert script.lowest_versions(asked) == {"hatchling": "1.2", "pyyaml": "6.0", "ray": "2.51"}


def test_of_two_bounds_of_a_package_the_higher_is_installed(script: ModuleType) -> None:
    asked = project("torch>=2.9.1", dev=["torch>=2.10"])
    assert script.lowest_versions(asked)["torch"] == "2.10"


def test_the_export_is_left_out_of_the_lowest_run_and_raises_torch_in_its_own(script: ModuleType) -> None:
    asked = project("torch>=2.9", dev=["torchweather[export]"], export=["torch>=2.13", "onnx>=1.17"])
    without = script.lowest_versions(asked, script.left_out_extras("lowest"))
    assert without == {"hatchling": "1.2", "torch": "2.9"}
    with_export = script.lowest_versions(asked, script.left_out_extras("lowest-export"))
    assert with_export == {"hatchling": "1.2", "torch": "2.13", "onnx": "1.17"}


def test_a_range_of_another_form_is_refused(script: ModuleType) -> None:
    with pytest.raises(SystemExit, match=r"torch~=2\.6"):
        script.lowest_versions(project("torch~=2.6"))


def test_versions_compare_by_their_numbers(script: ModuleType) -> None:
    assert script.release("2.13.0+cpu") == script.release("2.13")
    assert script.release("2.10") > script.release("2.9.1")
