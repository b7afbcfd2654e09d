"""An error of the package itself is shown with its traceback; a user's mistake is one line."""

from __future__ import annotations

import json
from typing import Any

import pytest

from torchweather.cli import listing, main
from torchweather.cli.mistakes import is_mistake, one_line
from torchweather.core.errors import TorchweatherError


def failing(error: Exception) -> Any:
    def run(args: object) -> int:
        raise error

    return run


@pytest.mark.parametrize(
    "error",
    [
        ZeroDivisionError("a bug"),
        AssertionError("a bug"),
        AttributeError("a bug"),
        ValueError("a bug"),
        TypeError("a bug"),
        ImportError("a bug"),
    ],
)
def test_a_bug_is_no_mistake_of_the_user(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listing, "run", failing(error))
    with pytest.raises(type(error), match="a bug"):
        main(["list"])


def test_a_mistake_is_one_line_and_a_traceback_on_demand(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(listing, "run", failing(TorchweatherError("x.npy: no cloud")))
    assert main(["list"]) == 2
    assert capsys.readouterr().err == "torchweather: error: x.npy: no cloud\n"
    with pytest.raises(TorchweatherError):
        main(["list", "--debug"])


def test_json_that_is_nested_too_deep_is_a_mistake_in_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RecursionError) as caught:
        json.loads("[" * 200_000)
    assert is_mistake(caught.value)
    assert "nested too deep" in one_line(caught.value)
    assert not is_mistake(RecursionError("ours"))
