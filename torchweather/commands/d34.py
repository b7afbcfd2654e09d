"""``torchweather d34``: tables of ROADVIEW D3.4 as published and corrected."""

from __future__ import annotations

import argparse

NAME = "d34"
SUMMARY = "tables of ROADVIEW D3.4 beside their correction"
DESCRIPTION = """Table 13, extinction of four measured fogs per colour in 1/m: as printed; as the deliverable's code
computes it (a radius where a diameter belongs, sizes cut at 0.2 and 20 um); corrected (Mie theory over all sizes)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("table", choices=["table13"], help="which table")


def run(args: argparse.Namespace) -> int:
    """Print the table."""
    from dataclasses import asdict

    from torchweather.commands.output import print_json, print_lines
    from torchweather.explain import aligned
    from torchweather.physics import table13

    rows = [asdict(row) for row in table13()]
    if args.json:
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
