"""Find out what microwave links lose beside the rain on their path: the search for a missing effect on real data.

    TORCHWEATHER_REAL_DATA=/data python examples/gap_wet_antenna.py      # /data/cml_openmrg, /data/cml_germany
    python examples/gap_wet_antenna.py --data folder-with-the-nc-files --halves 3 --out pages
    python examples/gap_wet_antenna.py --reference-sd 0.1     # the reference's mean rain may be off by a tenth

The links, the measured attenuation and the scores are those of ``links_against_p838.py``. The search is told nothing of
what to look for: it gets half of the links (in Germany on every other day) and answers; what it found is then added to
the model and judged on the other half. Printed, for each set: what it found, the scores before and after, as means over
seeded halves, how a scale of the path would rank, what a reference that is off would change, what no offset
betters, how much of what is left is the reference's own noise; for Germany also what the film of Gothenburg would do
there. ``--out`` writes the page of the first half. Needs ``torchweather[io]``; ``docs/links.md``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from parts.link_recordings import folder_of, read_germany, read_gothenburg
from parts.link_reports import report_least, report_noise, report_rivals, spread
from parts.link_scores import GERMANY, GOTHENBURG, HALVES, table
from parts.link_search import Held, said

from torchweather.gap import GapReport, find_gap
from torchweather.pipeline.effect import Effect
from torchweather.radar.effects.all import RadarWetRadome
from torchweather.report.gap_page import write_gap

SCORES = ("5-min RMSE", "hourly RMSE", "conditional bias")


def report(name: str, held: Held, halves: int, reference_sd: float, out: Path | None) -> list[GapReport]:
    """Searches and judges each half of a set; returns the answers."""
    print(f"\n## {name}\n\n{held.chosen.sum()} links; searched on one half of them, judged on the other.")
    if reference_sd:
        print(f"The reference's mean rain in each class may be off by {100.0 * reference_sd:g} %.")
    answers = [find_gap(held.study(seed, reference_sd)) for seed in range(halves)]
    if out is not None:
        write_gap(out / name.lower(), held.study(0, reference_sd), answers[0])

    table(
        ["half", "verdict", "effects", "gap before", "after", "floor"],
        [
            [
                str(seed),
                one.verdict,
                "; ".join(said(effect) for effect in one.effects) or "none",
                *(f"{one.answer['gap'][key]:.2f}" for key in ("before", "after", "floor")),
            ]
            for seed, one in enumerate(answers)
        ],
    )
    before = np.array([held.scores((), seed) for seed in range(halves)])
    after = np.array([held.scores_of(one, seed) for seed, one in enumerate(answers)])
    rows = [[label, spread(old), spread(new)] for label, old, new in zip(SCORES, before.T, after.T, strict=True)]
    table([f"held out, {halves} halves, dB", "P.838-3", "with what was found"], rows)
    for effect in answers[0].effects:
        if isinstance(effect, RadarWetRadome):
            low, high = answers[0].answer["effects"][0]["interval"]["drying_min"]
            print(f"\nOf the loss a tenth is left {2.3 * float(effect.drying_min):.0f} min after the rain", end=" ")
            print(f"({2.3 * low:.0f} to {2.3 * high:.0f} min).")
    return answers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder of the .nc files or above it; else TORCHWEATHER_REAL_DATA")
    parser.add_argument("--halves", type=int, default=HALVES, help="random halves of the links (default 10)")
    parser.add_argument(
        "--reference-sd",
        type=float,
        default=0.0,
        help="what the reference's mean rain in a class may be off by, relative (default 0: it counts as exact)",
    )
    parser.add_argument("--out", type=Path, help="folder for the page of the first half of each set")
    given = parser.parse_args()
    if given.halves < 1:
        parser.error(f"--halves: expected 1 or more; got {given.halves}")
    if not 0.0 <= given.reference_sd < 1.0:
        parser.error(f"--reference-sd: expected a relative standard deviation in 0..1; got {given.reference_sd:g}")
    gothenburg, germany = (folder_of(file, given.data) for file in ("openMRG_example.nc", "example_cml_data.nc"))
    if not germany and not gothenburg:
        sys.exit(
            "no link files: give --data FOLDER with openMRG_example.nc or example_cml_data.nc in it or one level "
            "below, set TORCHWEATHER_REAL_DATA to such a folder, or install pycomlink, which ships the second"
        )
    film: Sequence[Effect] = ()
    for name, folder, read, rules in (
        ("Gothenburg", gothenburg, read_gothenburg, GOTHENBURG),
        ("Germany", germany, read_germany, GERMANY),
    ):
        if folder is None:
            print(f"\nThe files of {name} were not found.")
            continue
        held = Held(read(folder), rules)
        answers = report(name, held, given.halves, given.reference_sd, given.out)
        report_rivals(held, answers[0], given.reference_sd)
        report_least(held, given.halves)
        report_noise(held, answers)
        if film:
            other = np.array([held.scores(film, seed) for seed in range(given.halves)])
            print(f"\nWith the film of Gothenburg, {said(film[0])}, {name} would have:")
            table(
                [f"held out, {given.halves} halves", "dB"],
                [[label, spread(one)] for label, one in zip(SCORES, other.T, strict=True)],
            )
        film = answers[0].effects


if __name__ == "__main__":
    main()
