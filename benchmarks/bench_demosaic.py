"""Time of the demosaicing of one camera frame, against one elementwise pass over the same array.

    python benchmarks/bench_demosaic.py --out benchmarks/demosaic.json

The yardstick is ``torch.exp(x, out=y)`` of the same array in the same run. Times with ``out=`` reuse their result;
fresh results pay for the page faults of new memory too.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import torch
from measure import machine, times_ms

from torchweather.image import demosaic

HEIGHT, WIDTH = 1464, 1936  # Sony IMX429, the sensor of the Lucid Triton TRI028S


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--repeats", type=int, default=30)
    arguments = parser.parse_args()

    frame = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))
    buffer, rgb = torch.empty_like(frame), torch.empty(3, HEIGHT, WIDTH)
    repeats = arguments.repeats
    in_place = times_ms(lambda: torch.exp(frame, out=buffer), 5 * repeats)["median_ms"]
    times = {
        "exp_in_place_ms": in_place,
        "exp_fresh_ms": times_ms(lambda: torch.exp(frame), repeats)["median_ms"],
        "malvar_out_ms": times_ms(lambda: demosaic(frame, "RGGB", out=rgb), repeats)["median_ms"],
        "malvar_rccb_out_ms": times_ms(lambda: demosaic(frame, "RCCB", out=rgb), repeats)["median_ms"],
        "malvar_fresh_ms": times_ms(lambda: demosaic(frame, "RGGB"), repeats)["median_ms"],
        "bilinear_kornia_ms": times_ms(lambda: demosaic(frame, "RGGB", "bilinear"), max(3, repeats // 5))["median_ms"],
    }
    result = {
        "what": f"demosaic {WIDTH} x {HEIGHT} float32",
        "machine": machine(),
        "times": {name: round(value, 3) for name, value in times.items()},
        "malvar_out_over_exp_in_place": round(times["malvar_out_ms"] / in_place, 2),
        "target_at_most": 40,
    }
    text = json.dumps(result, indent=2)
    if arguments.out is None:
        print(text)
    else:
        arguments.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
