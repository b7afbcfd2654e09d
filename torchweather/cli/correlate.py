"""``torchweather correlate``: scores of weather against the performance of a detector in it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

NAME = "correlate"
SUMMARY = "find the scores that follow a detector's performance in weather: a page and its numbers"
DESCRIPTION = """Correlates the scores of a sweep with the performance of a detector. SCORES is the table that
`torchweather sweep` writes. PERFORMANCE is a table with a column of numbers, such as average precision, and the same
condition columns, as far as they apply. These are subject, sensor, weather, knob, value, severity and seed. Rows are
matched by the condition columns that both have; seeds are averaged. Both are .csv or .parquet. Writes index.html,
correlation.json and conditions.csv."""

TALLY = {"agrees": "agree", "contradicts": "contradict", "cannot_be_judged": "cannot be judged"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("scores", type=Path, metavar="SCORES", help="table with the columns metric and score")
    parser.add_argument("performance", type=Path, metavar="PERFORMANCE", help="table of the detector's performance")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the page and its numbers")
    parser.add_argument(
        "--performance-column", default="performance", metavar="NAME", help="its name, such as AP; default performance"
    )
    parser.add_argument(
        "--by", metavar="A,B", help="columns that distinguish conditions; default all that both tables have, but seed"
    )
    parser.add_argument(
        "--highly", type=float, metavar="R", help="size of Spearman's rho that counts as high; default 0.7"
    )
    parser.add_argument("--resamples", type=int, default=2000, help="of the bootstrap; default 2000")
    parser.add_argument("--seed", type=int, default=0, help="of the bootstrap; default 0")


def run(args: argparse.Namespace) -> int:
    """Correlate and write."""
    from torchweather.cli.output import print_json, print_lines
    from torchweather.core.errors import TorchweatherError
    from torchweather.io import read_table
    from torchweather.metrics.correlation import correlate
    from torchweather.metrics.d34_claim import HIGHLY
    from torchweather.report.correlation_page import write_correlation

    scores, performance = read_table(args.scores), read_table(args.performance)
    missing = [name for name in ("metric", "score") if name not in scores]
    if missing:
        raise TorchweatherError(
            f"{args.scores}: expected the table of a sweep, one score a row, with the columns metric and score; got "
            f"{', '.join(scores)}."
        )
    found = correlate(
        scores,
        performance,
        by=None if args.by is None else [name.strip() for name in args.by.split(",") if name.strip()],
        performance_column=args.performance_column,
        resamples=args.resamples,
        seed=args.seed,
        highly=HIGHLY if args.highly is None else args.highly,
    )
    summary = write_correlation(args.out, found, performance=args.performance_column)
    if args.json:
        print_json(summary)
    else:
        print_lines("\n".join([*correlation_lines(summary), f"wrote {args.out / 'index.html'}"]))
    return 0


def correlation_lines(summary: dict[str, Any]) -> list[str]:
    """The numbers as text."""
    from torchweather.core.text import aligned

    rows = [["rank", "metric", "rho", "95 %", "tau", "r", "given level", "error", "by level", "D3.4 says", "found"]]
    claims = {each["metric"]: each for each in summary["d34_claim"]["metrics"]}
    for each in summary["metrics"]:
        rho, claim = each["spearman"], claims.get(each["metric"])
        rows.append(
            [
                "-" if each["rank"] is None else str(each["rank"]),
                each["metric"],
                _number(rho["value"]),
                f"{_number(rho['low'])}..{_number(rho['high'])}",
                _number(each["kendall"]["value"]),
                _number(each["pearson"]["value"]),
                _number(each["partial_rank"]["value"]),
                _number(each["prediction"]["rmse"], 3),
                _number(each["prediction"]["rmse_of_level"], 3),
                "" if claim is None else "high" if claim["claimed_high"] else "not high",
                "" if claim is None else claim["verdict"],
            ]
        )
    lines = [f"{summary['performance']} over {summary['conditions']} conditions", "", *aligned(rows)]
    if claims:
        said = summary["d34_claim"]
        lines += ["", f"{said['place']}: {said['text']}"]
        counts = ", ".join(f"{said[key]} {words}" for key, words in TALLY.items())
        lines.append(f"Found, high from {said['highly']:g} on: {counts}.")
    return lines


def _number(value: float | str, digits: int = 2) -> str:
    return "-" if isinstance(value, str) else f"{value:.{digits}f}"
