"""Scores of point-cloud files for ``torchweather metrics``."""

from __future__ import annotations

import argparse
from pathlib import Path

from torch import Tensor

from torchweather.cli.clouds import reading_of
from torchweather.cli.pairs_of_files import DETECTIONS
from torchweather.cli.regions import parse_region
from torchweather.core.errors import TorchweatherError, check_one_of
from torchweather.io import read_points, read_radar
from torchweather.metrics import CLOUD_SCORES, cloud_scores
from torchweather.radar.sensor import Radar

__all__ = ["CloudScores"]

MORE_SCORES = ("chamfer", "chamfer_squared")
UNITS = {"sdm": "0 to 1", "chamfer_squared": "m^2"}


class CloudScores:
    """Scores of pairs of cloud files.

    Args:
        names: of ``CLOUD_SCORES``, or ``chamfer`` or ``chamfer_squared``; ``None``: the six of ``CLOUD_SCORES``.
        kind: ``point clouds`` or ``radar detections``.
        args: of the command line.
    """

    def __init__(self, names: list[str] | None, kind: str, args: argparse.Namespace) -> None:
        for name in names or ():
            check_one_of("--metrics", name, (*CLOUD_SCORES, *MORE_SCORES), owner="metrics")
        self.names = list(CLOUD_SCORES) if names is None else names
        self.columns = self.names
        self.correspondence = args.rmse or "nearest"
        self.region = None if args.region is None else parse_region(args.region)
        self.reading = reading_of(args)
        self.radar: Radar | None = None
        self.detections = kind == DETECTIONS
        preset = (args.sensor or "").partition(":")[2]
        if self.detections and preset:
            self.radar = Radar.preset(preset)

    def better(self, name: str) -> str:
        """Direction in which a score is better, in words."""
        return f"{UNITS.get(name, 'm')}, lower is better, identical clouds 0"

    def score(self, reference: Path, distorted: Path) -> dict[str, float]:
        """Scores of one pair."""
        clear, worse = self._points(reference), self._points(distorted)
        if "rmse" in self.names and self.correspondence == "index" and len(clear) != len(worse):
            raise TorchweatherError(
                f"{distorted}: --rmse index pairs row i with row i; expected as many rows as {reference} has, "
                f"{len(clear)}; got {len(worse)}. Keep lost points as rows (apply --lost zero), or take --rmse nearest."
            )
        found = cloud_scores(
            worse, clear, names=self.names, correspondence=self.correspondence, region=self.region, owner="metrics"
        )
        return {name: float(score) for name, score in found.items()}

    def _points(self, path: Path) -> Tensor:
        if self.detections:
            return read_radar(path, self.radar).points[:, :3]
        how = self.reading
        return read_points(path, intensity="none", bin_columns=how.bin_columns, bin_dtype=how.bin_dtype).points[:, :3]
