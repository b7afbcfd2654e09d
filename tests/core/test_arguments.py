"""Kinds and shapes of arguments, declared by the head of a function."""

from __future__ import annotations

import ast
import inspect
import re
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import torchweather
from torchweather.core.arguments import call_given, check_arguments, check_broadcast
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.image import demosaic
from torchweather.io import read_points
from torchweather.radar import range_doppler
from torchweather.sensors import Camera, Lidar, Radar

CAMERA = Camera.from_intrinsics(20.0, 20.0, 7.5, 5.5, 16, 12)
FITTING: list[tuple[str, Any]] = [
    ("float", 1),
    ("float", np.float32(2.5)),
    ("float", torch.tensor([1.0])),
    ("int", np.int64(3)),
    ("int", torch.tensor(3)),
    ("bool", np.bool_(True)),
    ("Quantity", [1.0, 2.0]),
    ("Quantity", torch.arange(3)),
    ("Quantity", [[1.0, 2.0], [3.0, 4.0]]),
    ("Quantity", [torch.tensor(1.0), 2.0]),
    ("Quantity", []),
    ("Sequence[float]", np.array([1.0, 2.0])),
    ("Sequence[int]", range(3)),
    ("Mapping", OrderedDict()),
    ("Mapping[str]", {"a": 1}),
    ("Sequence[Tensor]", [torch.zeros(1)]),
    ("Iterable", iter([1])),
    ("Callable", len),
    ("path", Path("a")),
    ("Camera | None", None),
    ("Camera | None", CAMERA),
    ("array", np.arange(3)),
    ("mask", torch.tensor([True])),
    ("whole", torch.tensor([1], dtype=torch.uint8)),
    ("real(..., 3)", torch.zeros(5, 2, 3)),
    ("floating(2+)", torch.zeros(7)),
    ("dtype", torch.float32),
]
OTHER: list[tuple[str, Any, str]] = [
    ("float", True, "a must be a number; got True"),
    ("float", "3", "a must be a number; got '3'"),
    ("float", torch.tensor([1.0, 2.0]), r"a must be a number; got torch.float32 \(2,\)"),
    ("int", 2.5, "a must be a whole number"),
    ("bool", 1, "a must be True or False"),
    ("str", 5, "a must be text"),
    ("Tensor", [1.0], "a must be a tensor"),
    ("real", torch.tensor([1j]), "a must be a tensor of real numbers; got torch.complex64"),
    ("floating", torch.arange(3), "a must be a floating-point tensor; got torch.int64"),
    ("Quantity", torch.tensor([True]), "a must be a number or a tensor of real numbers"),
    ("Quantity", [[1.0, 2.0], [3.0]], "a must be a number or a tensor of real numbers"),
    ("Quantity", [1.0, "a"], "a must be a number or a tensor of real numbers"),
    ("Sequence", "abc", "a must be a sequence"),
    ("Sequence[float]", torch.zeros(2, 3), "a must be a sequence of float"),
    ("Sequence[float]", [np.array(2.0), 1.0], "a must be a sequence of float"),
    ("Sequence[str]", range(3), "a must be a sequence of str"),
    ("Mapping[str]", {1: None}, "a must be a mapping of str"),
    ("Sequence[Tensor]", [torch.zeros(1), 2], "a must be a sequence of Tensor"),
    ("Camera | None", object(), "a must be a Camera or None"),
    ("array", np.array(["a"]), "a must be an array of real numbers"),
    ("path", 5, "a must be the path of a file"),
]


@pytest.mark.parametrize(("kind", "value"), FITTING)
def test_values_that_fit(kind: str, value: Any) -> None:
    check_arguments(f"f(a: {kind})", value)


@pytest.mark.parametrize(("kind", "value", "message"), OTHER)
def test_values_of_another_kind_are_named(kind: str, value: Any, message: str) -> None:
    with pytest.raises(InputTypeError, match=f"^f: {message}"):
        check_arguments(f"f(a: {kind})", value)


def test_a_message_stays_short() -> None:
    with pytest.raises(InputTypeError) as caught:
        check_arguments("f(a: float)", "x" * 10**6)
    assert len(str(caught.value)) < 300


def test_shapes_are_compared_with_each_other() -> None:
    head = "f(points: real(..., N, 3+), kind: whole(N))"
    check_arguments(head, torch.zeros(2, 5, 4), torch.zeros(5, dtype=torch.int64))
    with pytest.raises(InputValueError, match=r"f: kind must have shape \(N,\) with N = 5; got \(6,\)"):
        check_arguments(head, torch.zeros(5, 4), torch.zeros(6, dtype=torch.int64))
    with pytest.raises(InputValueError, match=r"points must have shape \(\.\.\., N, 3 or more\).*; got \(5, 2\)"):
        check_arguments(head, torch.zeros(5, 2), torch.zeros(5, dtype=torch.int64))


def test_lists_broadcast_as_tensors_do() -> None:
    check_broadcast("f", first=[[1.0], [2.0]], second=torch.zeros(3), third=1.0)
    with pytest.raises(InputValueError, match=r"f: shapes must broadcast; got first \(0,\), second \(2, 3\)"):
        check_broadcast("f", first=[], second=torch.zeros(2, 3))


def test_a_function_that_does_not_take_its_values_is_named() -> None:
    with pytest.raises(InputTypeError, match=r"f: law must take .* which raises ValueError: only one element"):
        call_given("f", "law", float, torch.zeros(2))
    with pytest.raises(InputValueError, match="demosaic"):  # an error of the package stays as it is
        call_given("f", "law", lambda raw: demosaic(raw, "RGGB"), torch.zeros(3))


@pytest.mark.parametrize("path", ["a\0b", "\ud800", b"a"])
def test_names_that_no_file_can_have(path: Any) -> None:
    with pytest.raises((InputValueError, InputTypeError), match="read_points: path must be the"):
        read_points(path)


@pytest.mark.parametrize(
    "call",
    [
        lambda: demosaic("x", "RGGB"),
        lambda: range_doppler(torch.ones(1, 2, 4, dtype=torch.complex64), "radar"),
        lambda: CAMERA.resized("3", 4),
        lambda: Radar().gain_dbi(torch.zeros(3), torch.zeros(4)),
        lambda: Lidar(905.0).with_pose("here"),
    ],
)
def test_public_functions_name_the_argument(call: Any) -> None:
    with pytest.raises((InputTypeError, InputValueError), match=r"^[\w.]+: \w+ (must|expected)|^\w+: expected"):
        call()


def test_every_head_names_parameters_of_its_function() -> None:
    """A parameter that was renamed is renamed in its head, too, and has its value there."""
    for file in Path(inspect.getfile(torchweather)).parent.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text if "check_arguments(" in text else "")):
            if not isinstance(node, ast.Call) or ast.unparse(node.func) != "check_arguments":
                continue
            head = node.args[0]
            if not isinstance(head, ast.Constant):
                continue
            names = re.findall(r"(\w+): ", head.value.partition("(")[2])
            # ``at`` holds the options of a transform without their distributions.
            values = [ast.unparse(value).removeprefix("self.").removeprefix("at.") for value in node.args[1:]]
            assert len(names) == len(values), f"{file}: {head.value}"
            if set(names) & set(values):
                assert names == values, f"{file}: {head.value}"
