"""See which image scores tell what a detector makes of the weather, with no data of your own.

    python examples/metrics_against_detector.py

Puts cars at random places of the embedded test track, trains a small detector on clear frames, and lets it find the
cars of other frames in rain, fog and snow of five severities each. Average precision, the 14 image scores and what they
have to do with each other become tables and a page. About two minutes on one core; --quick is smaller.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from parts.car_detector import Batch, Frame, frame, picture, precision, targets, trained

import torchweather as tw
from torchweather.io import write_table
from torchweather.metrics import correlate, image_scores
from torchweather.report.correlation_page import write_correlation

WEATHERS: dict[str, tuple[str, list[float]]] = {
    "rain": ("rate_mm_per_h", [5.0, 15.0, 40.0, 80.0, 150.0]),
    "fog": ("mor_m", [1000.0, 500.0, 250.0, 120.0, 60.0]),
    "snow": ("rate_mm_per_h", [0.5, 1.0, 2.5, 5.0, 10.0]),
}
CLASSES = {"rain": tw.Rain, "fog": tw.Fog, "snow": tw.Snow}
BATCH = 4


# ---- the detector, on clear frames -----------------------------------------------------------------------------------


def clear_batches(frames: list[Frame], steps: int) -> Iterator[Batch]:
    """Frames drawn at random, as they are."""
    pictures = torch.stack([picture(each.bayer, each.camera) for each in frames])
    parts = [torch.stack(part) for part in zip(*map(targets, frames), strict=True)]
    for _ in range(steps):
        chosen = torch.randint(len(frames), (BATCH,))
        yield pictures[chosen], *(part[chosen] for part in parts)  # type: ignore[misc]


# ---- all together --------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("metrics_against_detector"), help="folder for tables and page")
    parser.add_argument("--train", type=int, default=20, help="clear frames to learn from")
    parser.add_argument("--test", type=int, default=8, help="other frames, to find cars in")
    parser.add_argument("--steps", type=int, default=450, help="of training")
    parser.add_argument("--quick", action="store_true", help="few frames, little training, two severities")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.train, arguments.test, arguments.steps = 3, 2, 20

    learned = [frame(seed) for seed in range(arguments.train)]
    detector = trained(clear_batches(learned, arguments.steps), arguments.steps)
    frames = [frame(10_000 + seed) for seed in range(arguments.test)]
    clear = torch.stack([picture(each.bayer, each.camera) for each in frames])
    print(f"clear: average precision {precision(detector, clear, frames):.2f}")

    scores: dict[str, list[Any]] = {
        name: [] for name in ("subject", "sensor", "weather", "knob", "value", "severity", "seed", "metric", "score")
    }
    performance: dict[str, list[Any]] = {name: [] for name in ("sensor", "weather", "value", "AP")}
    for weather, (intensity, values) in WEATHERS.items():
        for severity, value in enumerate(values[1::3] if arguments.quick else values, 1):
            pictures = []
            for seed, each in enumerate(frames):
                bad_weather = tw.BayerWeather(CLASSES[weather](**{intensity: value}), each.camera)
                noise = bad_weather.draw(each.bayer, seed=seed)
                pictures.append(picture(bad_weather(each.bayer, each.depth_m, noise), each.camera))
            weathered = torch.stack(pictures)
            found = precision(detector, weathered, frames)
            for column, entry in zip(performance.values(), ("camera", weather, value, found), strict=True):
                column.append(entry)
            for metric, per_frame in image_scores(weathered, clear).items():
                for seed, score in enumerate(per_frame.tolist()):
                    row = (f"frame {seed}", "camera", weather, intensity, value, severity, seed, metric, score)
                    for column, entry in zip(scores.values(), row, strict=True):
                        column.append(entry)
            print(f"{weather} {intensity} {value:g}: average precision {found:.2f}")

    result = correlate(scores, performance, performance_column="AP")
    note = (
        f"A small convolutional detector, trained on {arguments.train} clear frames of the embedded test track, finds "
        f"cars in {arguments.test} others; average precision at an overlap of 0.5."
    )
    write_correlation(arguments.out, result, performance="AP", notes=(note,))
    write_table(arguments.out / "scores.csv", scores)
    write_table(arguments.out / "performance.csv", performance)
    print("\nmetric     rho   95 %            given level   D3.4 says   found")
    claims = {each.metric: each for each in result.claim}
    for each in result.metrics:
        rho, claim = each.spearman, claims[each.metric]
        said = "high" if claim.claimed_high else "not high"
        print(
            f"{each.metric:8s} {rho.value:+5.2f}   {rho.low:+.2f} to {rho.high:+.2f}   "
            f"{each.partial_rank.value:+11.2f}   {said:9s}   {claim.verdict}"
        )
    print(f"\npage: {arguments.out / 'index.html'}")


if __name__ == "__main__":
    main()
