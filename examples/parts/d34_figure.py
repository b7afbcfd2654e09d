"""Answer of a search as a table and a picture: hidden and found, before and after, the held-out gap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchweather.explain import aligned
from torchweather.gap import GapReport
from torchweather.io import atomic_write
from torchweather.report.gap_words import (
    axis_name,
    edge_text,
    effect_name,
    parameter_rows,
    statistic_name,
)

BEFORE, AFTER = "#e03131", "#1c7ed6"
TICKS = (-300, -100, -30, -10, -3, 0, 3, 10, 30, 100, 300)  # of departures, in scatters


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Hidden and found, parameter by parameter, and the held-out gap."""
    lines = [["D3.4", "hidden", "found", "90 % interval", "held-out gap", "floor"]]
    for row in rows:
        gap = row["gap"]
        shrunk = [f"{gap['before']:.2f} -> {gap['after']:.2f}", f"{gap['floor']:.2f}"]
        hidden, found = (
            {name: text for one in row[key] for name, text in _texts(one).items()} for key in ("hidden", "found")
        )
        for place, name in enumerate(dict.fromkeys([*hidden, *found])):
            first = place == 0
            value, interval = found.get(name, (row["verdict"] if first and not found else "-", ""))
            wanted = f"{name} {hidden[name][0]}" if name in hidden else f"(not {name})"
            lines.append([row["section"] if first else "", wanted, value, interval, *(shrunk if first else ["", ""])])
    return "\n".join(aligned(lines))


def _texts(effect: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """``effect.parameter`` to its value with unit, and its interval."""
    return {
        f"{effect['name']}.{row['name']}": (f"{row['value']} {row['unit']}".strip(), row["interval"])
        for row in parameter_rows({"interval": {}, **effect})
    }


def draw(path: Path, row: Mapping[str, Any], report: GapReport) -> None:
    """The statistic that departs most, before and after, and the held-out gap beside its floor."""
    from matplotlib.figure import Figure

    first = report.curves[0]
    shown = [one for one in report.curves if (one.statistic, one.axis) == (first.statistic, first.axis)]
    figure = Figure(figsize=(10.5, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
    bins = np.arange(len(first.edges) - 1)
    left.axhspan(-1, 1, color="0.88", label="scatter of the simulation")
    for number, curve in enumerate(shown):
        label = {"before": "before", "after": "after"} if number == 0 else {"before": None, "after": None}
        left.plot(bins, curve.before, "o-", color=BEFORE, markersize=4, linewidth=1, label=label["before"])
        if curve.after is not None:
            hollow: dict[str, Any] = {"markerfacecolor": "white", "markersize": 4, "linewidth": 1}
            left.plot(bins, curve.after, "s-", color=AFTER, label=label["after"], **hollow)
    left.set_yscale("symlog", linthresh=3.0, linscale=0.6)
    left.set_yticks([y for y in TICKS if left.get_ylim()[0] <= y <= left.get_ylim()[1]], minor=False)
    left.yaxis.set_major_formatter("{x:g}")
    left.minorticks_off()
    every = -(-len(first.edges) // 12)
    left.set_xticks(
        (np.arange(len(first.edges)) - 0.5)[::every], [edge_text(first.axis, x) for x in first.edges][::every]
    )
    left.set(
        title=f"{statistic_name(first.statistic)}, {len(shown)} conditions",
        xlabel=axis_name(first.axis),
        ylabel="measured − simulated, scatters",
    )
    left.grid(axis="y", alpha=0.3)
    left.legend(fontsize=9)
    gap = row["gap"]
    right.bar(["before", "after"], [gap["before"], gap["after"]], color=[BEFORE, AFTER], width=0.55)
    right.axhline(gap["floor"], color="0.3", linestyle="--", linewidth=1.2, label=f"floor {gap['floor']:.2f}")
    for place, name in enumerate(("before", "after")):
        right.annotate(f"{gap[name]:.2f}", (place, gap[name]), (0, 3), textcoords="offset points", ha="center")
    right.margins(y=0.12)
    right.set(title="Condition held out", ylabel="departure, root mean square, scatters")
    right.legend(fontsize=9)
    hidden = " and ".join(_short(one) for one in row["hidden"])
    found = " and ".join(_short(one) for one in row["found"]) or row["verdict"]
    figure.suptitle(f"D3.4 {row['section']}: {row['suspected']}\nhidden: {hidden}\nfound: {found}", fontsize=10.5)
    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=110)


def _short(effect: Mapping[str, Any]) -> str:
    values = ", ".join(f"{row['name']} {row['value']}" for row in parameter_rows({"interval": {}, **effect}))
    return f"{effect_name(effect['name'])} ({values})"
