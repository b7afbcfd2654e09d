"""Write docs/sensitivity.md: every default that moves a result by more than 20 % over its plausible range.

    python benchmarks/sensitivity.py            # three minutes; writes docs/sensitivity.md
    python benchmarks/sensitivity.py --only radar --out /tmp/radar.md

Each default is changed alone. Sources of the values stand in ``torchweather/evaluation/sensitivity/change.py``.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from torchweather.evaluation.sensitivity import Moved, sensitivity
from torchweather.io import atomic_write

PAGE = Path(__file__).parents[1] / "docs" / "sensitivity.md"
SENSORS = {"lidar": "lidar:ouster-os1-128", "camera": "camera:lucid-triton", "radar": "radar:imaging-77ghz"}
WEATHERS = ("rain:rate=25", "fog:mor=100", "snow:rate=1")
MOVES = 1.2  # or its inverse

HEAD = """# Which defaults decide the result

Some defaults rest on no measurement of your sensor. This page changes each of them alone to other values that
are as plausible, and lists those that move a result by more than 20 %. `python benchmarks/sensitivity.py`
writes it. For your own weather and sensor:

```sh
torchweather explain --weather fog:mor=100 --sensor lidar:ouster-os1-128 --uncertainty
```

Results are a LiDAR's effective extinction, its share of beams into open air that return from particles (false
returns), and the share of objects of 10 % reflectivity at 20 m that it no longer reports (lost returns). Of a
camera they are the rendered extinction, and the mean and deviation that the weather adds to a grey wall at 50
m. Of a radar they are attenuation and backscatter. Defaults that vary together go further than one alone.
Shares below 0.001 count as none.
"""

TAIL = """
## What to do

Measure the near response of your LiDAR first: no other default moves so much. [`torchweather
fit-sensor`](how-to/sweeps-of-my-lidar.md) estimates it from clear sweeps of a sensor that reports photons, and
`apply` takes it as `--near-start-m`, `--near-full-m` and `--near-power`. Where you cannot measure, [draw the
value](how-to/draw-what-is-not-known.md) for each sample.
"""


def table(rows: list[Moved]) -> str:
    lines = ["| default | value | result | by default | then | source |", "| --- | --- | --- | --- | --- | --- |"]
    lines += [
        f"| {row.change.default} | {row.change.value} | {row.result} | {row.before:.3g} | {row.after:.3g} "
        f"| {row.change.source} |"
        for row in rows
    ]
    return "\n".join(lines)


def page(kinds: list[str]) -> str:
    parts = [HEAD]
    for kind in kinds:
        parts.append(f"## {kind.capitalize() if kind != 'lidar' else 'LiDAR'}: `{SENSORS[kind]}`\n")
        for weather in WEATHERS:
            moved = sensitivity(weather, SENSORS[kind])
            strong = [row for row in moved if abs(math.log(max(row.factor, 1e-300))) > math.log(MOVES)]
            weak = sorted({row.change.default for row in moved} - {row.change.default for row in strong})
            parts.append(f"### `{weather}`\n")
            parts.append(table(strong) + "\n" if strong else "No default moves a result by more than 20 %.\n")
            if weak:
                parts.append(f"Within 20 %: {', '.join(weak)}.\n")
    return "\n".join([*parts, TAIL.lstrip("\n")]).rstrip("\n") + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=tuple(SENSORS), help="one kind of sensor")
    parser.add_argument("--out", type=Path, default=PAGE, help="file to write")
    arguments = parser.parse_args()
    text = page([arguments.only] if arguments.only else list(SENSORS))
    with atomic_write(arguments.out) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
    print(f"written: {arguments.out}")


if __name__ == "__main__":
    main()
