"""Mistakes that need no torch: found before it is loaded, in the words of the command itself."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from torchweather.cli import program
from torchweather.core.exceptions import InputValueError, TorchweatherError

MISTAKES = [
    ["explain", "--weather", "hail"],
    ["explain", "--weather", "rain:rate=5+fogg:mor=3"],
    ["explain", "--weather", "rain:rate=5", "--sensor", "lidar:ouster-os1-12"],
    ["apply", "IN", "-o", "OUT"],
    ["apply", "IN", "-o", "OUT", "--recipe", "camera/fog-10"],
    ["apply", "IN", "-o", "OUT", "--weather", "hail:rate=1"],
    ["apply", "IN", "-o", "OUT", "--weather", "rain:rate=5", "--sensor", "camera:nosuch"],
    ["apply", "MISSING.png", "-o", "OUT", "--weather", "rain:rate=5"],
    ["apply", "MISSING.bin", "-o", "OUT", "--weather", "rain:rate=5", "--sensor", "lidar"],
    ["apply", "MISSING.npz", "-o", "OUT", "--weather", "rain:rate=5", "--sensor", "radar"],
    ["apply", "MISSING.mp4", "-o", "OUT", "--weather", "rain:rate=5"],
    ["view", "MISSING.bin", "--weather", "rain:rate=5"],
    ["metrics", "IN", "MISSING.png"],
]


@pytest.fixture
def placed(tmp_path: Path) -> dict[str, str]:
    (tmp_path / "in.png").write_bytes(b"")
    return {"IN": str(tmp_path / "in.png"), "OUT": str(tmp_path / "out")}


def message(words: list[str]) -> str:
    args = program.build_parser().parse_args(words)
    with pytest.raises(TorchweatherError) as found:
        args.run(args)
    return str(found.value)


@pytest.mark.parametrize("words", MISTAKES, ids=" ".join)
def test_an_early_mistake_has_the_words_of_the_command(words: list[str], placed: dict[str, str]) -> None:
    said = [placed.get(word, word) for word in words]
    args = program.build_parser().parse_args(said)
    with pytest.raises(InputValueError) as early:
        program.refuse_early(args, said[0])
    assert str(early.value) == message(said)


def test_early_mistakes_load_no_torch(placed: dict[str, str]) -> None:
    said = [[placed.get(word, word) for word in words] for words in MISTAKES]
    code = (
        "import sys; from torchweather.cli.program import main\n"
        f"codes = [main(words) for words in {said!r}]\n"
        "print(codes, 'torch' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert found.stdout.split() == f"{[2] * len(said)} False".split()


def test_what_is_right_or_seen_later_passes(placed: dict[str, str]) -> None:
    for words in (
        ["apply", "scene:street", "-o", "OUT", "--weather", "rain:rate=5", "--sensor", "radar"],
        ["apply", "IN", "-o", "OUT", "--recipe", "fog-10m"],
        ["apply", "IN", "-o", "OUT", "--recipe", "own.yaml"],
        ["explain", "--weather", "rain:rate=5 + wet-road:water=1", "--sensor", "lidar"],
        ["list"],
    ):
        said = [placed.get(word, word) for word in words]
        program.refuse_early(program.build_parser().parse_args(said), said[0])
