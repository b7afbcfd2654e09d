"""The checks speak with one voice: who, what was wanted with its unit, what came, what to do."""

from __future__ import annotations

import ast
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import torch

import torchweather
from torchweather.camera.night.lamps import Lamp
from torchweather.core.errors import (
    InputTypeError,
    MissingExtraError,
    TorchweatherError,
    TorchweatherWarning,
    check_at_least,
    check_between,
    check_finite,
    check_one_of,
    check_positive,
    nearest_name,
)
from torchweather.core.extras import install_hint


class Gauge:
    pass


def test_message_names_owner_quantity_unit_value_and_advice() -> None:
    with pytest.raises(ValueError, match=re.escape("Gauge: depth_m must be 0 m or more; got -1.0. Flip the sign.")):
        check_at_least("depth_m", -1.0, 0.0, unit="m", owner=Gauge(), advice="Flip the sign.")
    with pytest.raises(ValueError, match=re.escape("Gauge: mor_m must be above 0 m; got 0.")):
        check_positive("mor_m", 0, unit="m", owner=Gauge)
    with pytest.raises(ValueError, match=re.escape("gauge: share must lie in 0..1; got 1.5.")):
        check_between("share", 1.5, 0.0, 1.0, owner="gauge")
    with pytest.raises(ValueError, match=re.escape("gauge: fx must be a finite number in px; got inf.")):
        check_finite("fx", math.inf, unit="px", owner="gauge")


def test_unknown_name_lists_the_known_ones_and_suggests_the_nearest() -> None:
    with pytest.raises(ValueError, match=re.escape("one of rain, snow; got 'rian'. Did you mean 'rain'?")):
        check_one_of("weather", "rian", ("rain", "snow"), owner="gauge")
    assert nearest_name("zebra", ("rain", "snow")) == ""


@pytest.mark.parametrize("value", [math.nan, torch.tensor(math.nan), torch.tensor([1.0, math.nan]), "3", None, True])
def test_nan_and_what_is_no_number_never_pass(value: object) -> None:
    for check in (check_finite, check_positive):
        with pytest.raises(ValueError, match="gauge: x"):
            check("x", value, owner="gauge")
    with pytest.raises(ValueError, match="gauge: x"):
        check_at_least("x", value, -math.inf, owner="gauge")
    with pytest.raises(ValueError, match="gauge: x"):
        check_between("x", value, -math.inf, math.inf, owner="gauge")


@pytest.mark.parametrize("digits", [400, 6000])
def test_a_whole_number_beyond_float64_is_out_of_every_range(digits: int) -> None:
    """Float64 has 308 digits, and Python writes 4,300."""
    for value in (10**digits, -(10**digits)):
        with pytest.raises(
            ValueError, match=r"gauge: x must be a finite number; got (-?1000|a whole number of too many)"
        ):
            check_finite("x", value, owner="gauge")
        with pytest.raises(ValueError, match="gauge: x must be 0 or more"):
            check_at_least("x", value, 0.0, owner="gauge")
        with pytest.raises(ValueError, match=r"gauge: x must lie in 0\.\.1"):
            check_between("x", value, 0.0, 1.0, owner="gauge")
        with pytest.raises(ValueError, match=r"Lamp: colour must lie in 0\.\.1000; got"):
            Lamp((1.0, 0.0, 0.0), colour=(value, 0.0, 0.0))


@pytest.mark.parametrize("value", [1, 1.0, np.float32(1), np.int64(1), torch.tensor(1.0), torch.tensor([1, 2])])
def test_numbers_of_python_numpy_and_torch_pass(value: object) -> None:
    check_finite("x", value, owner="gauge")
    check_positive("x", value, owner="gauge")
    check_at_least("x", value, 1, owner="gauge")
    check_between("x", value, 1, 2, owner="gauge")


def test_a_tensor_is_shown_by_its_range() -> None:
    with pytest.raises(ValueError, match=re.escape("got a tensor with values -2..3.")):
        check_positive("x", torch.tensor([3.0, -2.0]), owner="gauge")


def test_an_empty_tensor_has_no_wrong_value() -> None:
    check_positive("x", torch.empty(0), owner="gauge")


def test_library_errors_are_no_value_errors_and_warnings_can_be_filtered() -> None:
    assert not issubclass(TorchweatherError, ValueError)
    assert issubclass(TorchweatherWarning, UserWarning)


def test_what_a_caller_can_mend_is_one_kind_of_error_and_python_s_own_kind_too() -> None:
    with pytest.raises(TorchweatherError) as value:
        check_positive("mor_m", 0, unit="m", owner=Gauge)
    assert isinstance(value.value, ValueError)
    assert issubclass(InputTypeError, TypeError)
    assert issubclass(MissingExtraError, ImportError)
    assert {InputTypeError, MissingExtraError} <= set(TorchweatherError.__subclasses__())


def test_package_raises_no_plain_value_or_type_error() -> None:
    """A plain ``ValueError`` is a defect, of which the command line shows the traceback."""
    plain = {"ValueError", "TypeError", "ImportError", "RuntimeError", "Exception", "KeyError"}
    found = []
    for path in sorted(Path(torchweather.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            call = node.exc if isinstance(node, ast.Raise) else None
            raised = call.func if isinstance(call, ast.Call) else call
            if isinstance(raised, ast.Name) and raised.id in plain:
                found.append(f"{path.name}:{node.lineno}: {raised.id}")
    assert not found


def test_messages_are_bounded_and_can_be_printed() -> None:
    shown = str(TorchweatherError(f"a\x1b[2Jb\udcff\n{'x' * 10_000_000}end"))
    assert shown.startswith("a\\x1b[2Jb\\udcff\nxxx")
    assert shown.endswith("xend")
    assert len(shown) < 9000
    shown.encode()
    assert str(TorchweatherError("Größe 3 µm\tgot 5")) == "Größe 3 µm\tgot 5"


def test_hints_of_extras_work_in_a_clone() -> None:
    package = Path(torchweather.__file__).parent
    project = tomllib.loads((package.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = set()
    for file in package.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        named |= set(re.findall(r"install_hint\(['\"](\w+)['\"]", text))
        # Every hint comes from the one function.
        assert "torchweather[" not in text or file.name == "extras.py", file
    assert named <= set(project["optional-dependencies"])
    assert {"export", "io", "ouster", "tables", "detection", "scale", "video", "view"} <= named
    assert install_hint("io").endswith("(in a clone of torchweather: pip install -e '.[io]').")
