"""``torchweather d34``: tables of ROADVIEW D3.4 as published and corrected."""

from __future__ import annotations

import argparse
from dataclasses import asdict

NAME = "d34"
SUMMARY = "tables of ROADVIEW D3.4 beside their correction"
DESCRIPTION = """table13, extinction of four measured fogs per colour in 1/m: as printed; as the deliverable's code
computes it (a radius where a diameter belongs, sizes cut at 0.2 and 20 um); corrected (Mie theory over all sizes).
trends, Tables 12, 14 and 15: how many metrics get worse as the weather does, as printed and counted from the scores of
the appendix; and where those scores contradict each other."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("table", choices=["table13", "trends"], help="table to print")


def run(args: argparse.Namespace) -> int:
    """Print the table."""
    return trends(as_json=args.json) if args.table == "trends" else table13(as_json=args.json)


def table13(*, as_json: bool) -> int:
    """Extinction of fog per colour."""
    from torchweather.cli.output import print_json, print_lines
    from torchweather.core.text import aligned
    from torchweather.physics import table13

    rows = [asdict(row) for row in table13()]
    if as_json:
        print_json(rows)
        return 0
    cells = [["visibility m", "colour", "printed", "as published", "corrected", "ln 20 / V"]]
    for row in rows:
        numbers = [f"{row[key]:.4f}" for key in ("printed", "as_published", "corrected", "koschmieder")]
        cells.append([f"{row['visibility_m']:g}", row["colour"], *numbers])
    title = "D3.4 Table 13: extinction of the REHEARSE fogs, 1/m"
    misprint = "10 m red is a misprint: .2989 for .2979."
    print_lines("\n".join([title, "", *("  " + line for line in aligned(cells)), "", misprint]))
    return 0


def trends(*, as_json: bool) -> int:
    """Expected trends per scene, and the contradictions of the appendix."""
    from torchweather.cli.output import print_json, print_lines
    from torchweather.core.text import aligned
    from torchweather.metrics.d34 import inconsistencies, trend_cells

    cells = trend_cells()
    numeric = [cell for cell in cells if cell.published is not None]
    found = inconsistencies()
    if as_json:
        print_json(
            {
                "cells": [asdict(cell) for cell in numeric],
                "cells_without_number": [asdict(cell) for cell in cells if cell.published is None],
                "inconsistencies": [asdict(each) for each in found],
            }
        )
        return 0
    rows = [["table", "sensor", "weather", "scene", "source", "published", "computed", "of", "levels"]]
    for cell in numeric:
        first = [str(cell.table), cell.sensor, cell.weather, cell.scene, cell.source]
        counts = [str(cell.published), str(cell.computed), str(cell.out_of)]
        rows.append([*first, *counts, f"{cell.levels}{' (coin flip)' if cell.coin_flip else ''}"])
    equal = sum(cell.published == cell.computed for cell in numeric)
    lines = ["D3.4 Tables 12, 14, 15: metrics that get strictly worse as the weather does", ""]
    lines += ["  " + line for line in aligned(rows)]
    lines += ["", f"{equal} of {len(numeric)} numbers are those of the appendix; a coin flip has two conditions.", ""]
    lines += ["Where the appendix contradicts itself", ""]
    for each in found:
        lines += [f"  {each.where}: {each.why}", f"      {each.found} of {each.of}; {each.detail}"]
    print_lines("\n".join(lines))
    return 0
