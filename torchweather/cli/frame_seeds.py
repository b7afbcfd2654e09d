"""The seed of each frame of a run: hashed from the run's seed and the frame's name, so that two runs share no storm."""

from __future__ import annotations

import argparse

__all__ = ["FrameSeeds", "add_seed_rule", "frame_name", "storm_seeds"]

HASHED, ADDED = "hashed", "added"
RULES = (HASHED, ADDED)


def frame_name(file: str, number: int | None) -> str:
    """The name that a cloud's seed is hashed with: its file's, and its number in a recording.

    Example:
        >>> frame_name("a.bin", None), frame_name("drive.pcap", 3)
        ('a.bin', 'drive.pcap/3')
    """
    return file if number is None else f"{file}/{number}"


class FrameSeeds:
    """Seeds of the frames of one run, asked for in their order.

    Args:
        seed: of the run.
        rule: ``hashed``: ``sample_seed(seed, name)``, which depends on nothing else; ``added``: the seed plus the
            number of the samples before, by which the runs of seed 0 and 1 share all storms but one.

    Example:
        >>> from torchweather.core.random import sample_seed
        >>> FrameSeeds(7, "hashed").of("000042.png") == sample_seed(7, "000042.png")
        True
        >>> seeds = FrameSeeds(7, "added")
        >>> seeds.of("a.npy", samples=2), seeds.of("b.png")
        (7, 9)
    """

    def __init__(self, seed: int, rule: str = HASHED) -> None:
        self.seed, self.rule = seed, rule
        self._samples = 0

    def of(self, name: str, samples: int = 1) -> int:
        """The seed of a frame; a file of several ``samples`` gives them this one and those that follow it by 1.

        Args:
            name: of the file without its folder, with ``/`` and its number for a frame of a recording.
            samples: in the file.
        """
        first = self._samples
        self._samples += samples
        if self.rule == ADDED:
            return self.seed + first
        from torchweather.core.random import sample_seed  # which imports numpy: the parser starts without it

        return sample_seed(self.seed, name)


def storm_seeds(seed: int, storms: int, rule: str = HASHED) -> list[int]:
    """The seeds of several storms of the same data.

    Example:
        >>> from torchweather.core.random import sample_seed
        >>> storm_seeds(5, 2, "added"), storm_seeds(5, 2) == [sample_seed(5, 0), sample_seed(5, 1)]
        ([5, 6], True)
    """
    from torchweather.core.random import sample_seed

    return [seed + k if rule == ADDED else sample_seed(seed, k) for k in range(storms)]


def add_seed_rule(parser: argparse.ArgumentParser) -> None:
    """The argument that brings back the seeds of earlier versions."""
    parser.add_argument(
        "--seed-rule",
        choices=RULES,
        default=HASHED,
        help="hashed (default): runs of two seeds share no storm; added: frame i takes seed + i, as before; it goes "
        "with the next release",
    )
