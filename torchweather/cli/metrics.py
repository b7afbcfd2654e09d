"""``torchweather metrics``: scores of images and point clouds against their references."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from torchweather.cli.clouds import add_bin_columns
from torchweather.cli.mistakes import is_mistake, one_line
from torchweather.cli.regions import REGION_HELP
from torchweather.core.exceptions import InputTypeError, InputValueError

NAME = "metrics"
SUMMARY = "scores of images and point clouds against a reference"
DESCRIPTION = """Scores DIST against REF: two files, or two folders whose files are matched by name (folders in them are
not entered). REF is the clear one and comes first (the functions in Python take the distorted one first); scores such
as VIF change when the two are swapped. Images: psnr ssim ms_ssim cw_ssim iw_ssim dss vif vsi fsim sr_sim haarpsi gmsd
ms_gmsd mdsi; white is the largest number of the file's integer type, or 1. A file with one value per pixel is a raw
mosaic. Point clouds and radar detections: sdm rmse mde mmde hd hd95, in metres but for sdm (0 to 1); chamfer and
chamfer_squared on request. In JSON, numbers that are not finite are the texts "inf", "-inf", "nan". A pair of folders
that cannot be scored is named, the others are scored, and the exit code is 2."""

FAILED = 2
IMAGES_ONLY = ("bayer", "pattern", "bit_depth", "black_level", "white_level", "gains", "encoding")
CLOUDS_ONLY = ("region", "rmse", "bin_columns", "bin_dtype")
Row = dict[str, Any]


class Scores(Protocol):
    """Scorer of pairs of files."""

    names: list[str]
    columns: list[str]

    def score(self, reference: Path, distorted: Path) -> dict[str, float]:
        """Scores of one pair, by the names in ``columns``."""

    def better(self, name: str) -> str:
        """Direction in which a score is better, in words."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("reference", type=Path, metavar="REF", help="clear file, or folder of clear files")
    parser.add_argument("distorted", type=Path, metavar="DIST", help="file or folder that is scored against it")
    parser.add_argument("--metrics", metavar="NAMES", help="scores joined by commas; default all of the kind")
    parser.add_argument("--csv", action="store_true", help="print CSV: reference, distorted and a column a score")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notes")
    parser.add_argument(
        "--sensor",
        help="camera, lidar or radar, with :PRESET: contents of the files, where their endings leave it open. By the "
        "preset a camera's mosaics (default lucid-triton) and a radar's detections are read",
    )
    images = parser.add_argument_group("images")
    images.add_argument(
        "--bayer",
        choices=("demosaic", "planes", "grey"),
        help="files with one value per pixel: the colour image after demosaic (default); each plane of the 2 x 2 cell "
        "(SCORE is the mean of the four, SCORE_r, SCORE_g1 ... are the planes'); or grey images, no mosaics",
    )
    images.add_argument("--pattern", help="colours of the top-left 2 x 2 pixels: RGGB, BGGR, GRBG, GBRG or RCCB")
    images.add_argument("--bit-depth", type=int, help="bits of the raw value")
    images.add_argument("--black-level", type=float, help="raw value of black")
    images.add_argument("--white-level", type=float, help="value of white, of colour and grey images too")
    images.add_argument(
        "--gains", nargs=3, type=float, metavar=("R", "G", "B"), help="white balance of both mosaics; default none"
    )
    images.add_argument(
        "--encoding", choices=("srgb", "linear"), help="mosaics are scored as display values (default) or linear light"
    )
    clouds = parser.add_argument_group("point clouds")
    clouds.add_argument("--region", help=REGION_HELP)
    add_bin_columns(clouds)
    clouds.add_argument(
        "--rmse", choices=("nearest", "index"), help="distance to the nearest point (default), or row i to row i"
    )


def run(args: argparse.Namespace) -> int:
    """Score the files and print what was found."""
    from torchweather.cli.output import note
    from torchweather.cli.pairs_of_files import pairs_of_files

    if args.json and args.csv:
        raise InputValueError("metrics: give --json or --csv, not both.")
    sensor = _sensor(args.sensor)
    found = pairs_of_files(args.reference, args.distorted, sensor)
    scores = _scores(args, found.kind)
    if found.unmatched_line():
        note(found.unmatched_line())
    if not found.folders:
        (pair,) = found.pairs
        _print_one(_row(scores, *pair), scores, args)
        return 0
    rows = _rows(found.pairs, scores, quiet=args.quiet)
    good = [row for row in rows if "error" not in row]
    mean = {name: sum(row[name] for row in good) / len(good) for name in scores.columns} if good else {}
    unmatched = {
        "reference": [path.name for path in found.only_reference],
        "distorted": [path.name for path in found.only_distorted],
    }
    _print_all(rows, mean, unmatched, scores, args)
    return 0 if len(good) == len(rows) else FAILED


def _sensor(text: str | None) -> str | None:
    """Kind of the sensor that was named."""
    from torchweather.cli.pairs_of_files import KIND_OF_SENSOR
    from torchweather.sensors import SENSOR_CLASSES

    if text is None:
        return None
    kind, _, preset = text.partition(":")
    if kind not in KIND_OF_SENSOR:
        raise InputValueError(f"metrics: --sensor must be camera, lidar or radar, with :PRESET; got {text!r}.")
    if preset:
        SENSOR_CLASSES[kind].preset(preset)  # an unknown name is refused here
    return kind


def _scores(args: argparse.Namespace, kind: str) -> Scores:
    """Scorer of files of this kind; arguments of the other kind are refused."""
    from torchweather.cli.pairs_of_files import IMAGES

    for name in CLOUDS_ONLY if kind == IMAGES else IMAGES_ONLY:
        if getattr(args, name) is not None:
            other = "point clouds" if kind == IMAGES else "images"
            raise InputValueError(f"metrics: --{name.replace('_', '-')} is for {other}; the files are {kind}.")
    names = _names(args.metrics)
    if kind == IMAGES:
        from torchweather.cli.score_images import ImageScores

        return ImageScores(names, args)
    from torchweather.cli.score_clouds import CloudScores

    return CloudScores(names, kind, args)


def _names(text: str | None) -> list[str] | None:
    if text is None:
        return None
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise InputValueError("metrics: --metrics must name scores joined by commas, such as psnr,ssim; got none.")
    return names


def _row(scores: Scores, reference: Path, distorted: Path) -> Row:
    from torchweather.core.errors import TorchweatherError

    try:
        found = scores.score(reference, distorted)
    except (InputValueError, InputTypeError) as error:
        raise TorchweatherError(f"{distorted}: {error}") from error
    return {"reference": str(reference), "distorted": str(distorted), **found}


def _rows(pairs: Sequence[tuple[Path, Path]], scores: Scores, *, quiet: bool) -> list[Row]:
    """A row for each pair; one that cannot be scored says why, here and on standard error."""
    from tqdm import tqdm

    rows = []
    for pair in tqdm(pairs, unit="pair", file=sys.stderr, disable=quiet or not sys.stderr.isatty()):
        try:
            rows.append(_row(scores, *pair))
        except Exception as error:
            if not is_mistake(error):
                raise
            said = one_line(error)
            sys.stderr.write(f"torchweather: error: {said}\n")
            rows.append({"reference": str(pair[0]), "distorted": str(pair[1]), "error": said})
    return rows


def _print_one(row: Row, scores: Scores, args: argparse.Namespace) -> None:
    from torchweather.cli.output import print_json, print_lines, spelled
    from torchweather.core.text import aligned

    if args.json:
        print_json(spelled(row))
    elif args.csv:
        _print_csv([row], scores)
    else:
        lines = aligned([[name, _number(row[name]), scores.better(name)] for name in scores.names])
        print_lines("\n".join([f"{row['distorted']} against {row['reference']}", "", *("  " + line for line in lines)]))


def _print_all(
    rows: list[Row], mean: dict[str, float], unmatched: dict[str, list[str]], scores: Scores, args: argparse.Namespace
) -> None:
    from torchweather.cli.output import print_json, print_lines, spelled
    from torchweather.core.text import aligned

    if args.json:
        print_json(spelled({"files": rows, "mean": mean, "unmatched": unmatched}))
        return
    if args.csv:
        _print_csv([*rows, {"reference": "mean", "distorted": "mean", **mean}] if mean else rows, scores)
        return
    table = [["file", *scores.names]]
    for row in [*rows, {"distorted": "mean", **mean}] if mean else rows:
        broken = "error" in row
        table.append(
            [Path(row["distorted"]).name, *("error" if broken else _number(row[name]) for name in scores.names)]
        )
    print_lines("\n".join(aligned(table)))


def _print_csv(rows: list[Row], scores: Scores) -> None:
    """CSV on standard output; the last column is there where a pair could not be scored, and says why."""
    import csv

    from torchweather.io.tables import text_cell

    header = ["reference", "distorted", *scores.columns, *(["error"] if any("error" in row for row in rows) else [])]
    writer = csv.DictWriter(sys.stdout, header, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: text_cell(cell) for name, cell in row.items()} for row in rows)


def _number(value: float) -> str:
    return f"{value:.4f}"
