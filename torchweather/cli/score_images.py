"""Scores of image files for ``torchweather metrics``: colour, grey, and raw mosaics."""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

from torchweather.camera.levels import levels, raw_to_linear
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import normalise
from torchweather.cli.output import note
from torchweather.core.errors import TorchweatherError, check_one_of
from torchweather.io import read_image
from torchweather.metrics import IMAGE_SCORES, bayer_scores, image_scores

__all__ = ["ImageScores"]

GREY = "grey"
PLANES = "planes"
OF_MOSAICS = ("bayer", "pattern", "bit_depth", "black_level", "gains", "encoding")
DEFAULT_CAMERA = "lucid-triton"
# Files of 10, 12 or 14 bits in 16 stay below this.
LESS_THAN_16_BITS = 2**14
# Images in [0, 1] have no value above 1, whatever white was said to be.
UNIT = 1.0


class ImageScores:
    """Scores of pairs of image files.

    Args:
        names: of ``IMAGE_SCORES``; ``None``: all.
        args: of the command line.
    """

    def __init__(self, names: list[str] | None, args: argparse.Namespace) -> None:
        for name in names or ():
            check_one_of("--metrics", name, IMAGE_SCORES, owner="metrics")
        self.names = list(IMAGE_SCORES) if names is None else names
        self.args = args
        self.preset = (args.sensor or "").partition(":")[2] or DEFAULT_CAMERA
        self.said: set[str] = set()
        self.columns = [*self.names]
        if args.bayer == PLANES:
            self.columns += [f"{name}_{plane}" for name in self.names for plane in plane_names(self._pattern())]

    def better(self, name: str) -> str:
        """Direction in which a score is better, in words."""
        facts = IMAGE_SCORES[name]
        return f"{'higher' if facts.higher_is_better else 'lower'} is better, identical images {facts.ideal:g}"

    def score(self, reference: Path, distorted: Path) -> dict[str, float]:
        """Scores of one pair; of planes their mean too."""
        clear, worse = _one_image(reference), _one_image(distorted)
        if clear.shape != worse.shape:
            raise TorchweatherError(
                f"{distorted}: expected the size of {reference}, {_size(clear)}; got {_size(worse)}."
            )
        mosaic = len(clear) == 1 and self.args.bayer != GREY
        if not mosaic:
            self._refuse_options_of_mosaics(reference)
        self._check_size(clear, reference)
        if not mosaic:
            pair = self._shown(worse, distorted), self._shown(clear, reference)
            return {name: float(score) for name, score in image_scores(*pair, self.names).items()}
        return self._of_mosaics(self._light(worse, distorted), self._light(clear, reference))

    def _of_mosaics(self, worse: Tensor, clear: Tensor) -> dict[str, float]:
        scored_as, pattern = self.args.bayer or "demosaic", self._pattern()
        if self.args.bayer is None:
            self._say(
                "mosaic",
                f"one value per pixel: scored as a raw mosaic ({pattern}), demosaiced; --bayer planes scores its "
                "planes, --bayer grey takes the files as grey images.",
            )
        found = bayer_scores(
            worse,
            clear,
            self.names,
            pattern=pattern,
            scored_as=scored_as,
            encoding=self.args.encoding or "srgb",
            gains=self.args.gains or (1.0, 1.0, 1.0),
        )
        scores = {name: float(score.mean()) for name, score in found.items()}
        if scored_as == PLANES:
            for name, score in found.items():
                for plane, value in zip(plane_names(pattern), score.tolist(), strict=True):
                    scores[f"{name}_{plane}"] = value
        return scores

    def _pattern(self) -> str:
        return str(self.args.pattern or Camera.preset(self.preset).bayer_pattern)

    def _camera(self, dtype: torch.dtype) -> Camera:
        """The camera with what the arguments replace, whose levels are numbers of the file."""
        given = {
            "bayer_pattern": self.args.pattern,
            "bit_depth": self.args.bit_depth,
            "black_level": self.args.black_level,
            "white_level": self.args.white_level,
        }
        fields = {name: value for name, value in given.items() if value is not None}
        if dtype == torch.uint8 and ("white_level" in fields or "black_level" in fields):
            # An 8-bit frame of a 12-bit camera holds the upper eight bits; levels that were given are the file's own.
            fields.setdefault("bit_depth", 8)
        return Camera.preset(self.preset, **fields)

    def _light(self, mosaic: Tensor, path: Path) -> Tensor:
        """Linear light of a mosaic in [0, 1]; a display shows nothing darker than black."""
        camera = self._camera(mosaic.dtype)
        if mosaic.is_floating_point():
            _check_white(mosaic, self.args.white_level, path)
            mosaic = normalise(mosaic, self.args.black_level or 0.0, self.args.white_level).clamp_min(0.0)
        else:
            _check_white(mosaic, levels(camera, mosaic.dtype)[1], path)
        return raw_to_linear(mosaic, camera, str(path)).clamp_min(0.0)

    def _shown(self, image: Tensor, path: Path) -> Tensor:
        """An image for display in [0, 1]."""
        white = self.args.white_level
        _check_white(image, white, path)
        if white is None and image.dtype == torch.uint16:
            highest = int(image.int().max())
            if highest < LESS_THAN_16_BITS:
                self._say(
                    "16 bits",
                    f"{path}: 16 bits, but no value above {highest}; if white is less than 65535, give --white-level "
                    "(a wrong white shifts PSNR and more).",
                )
        light = normalise(image, 0.0, white)
        return light if light.dtype in (torch.float32, torch.float64) else light.float()

    def _check_size(self, image: Tensor, path: Path) -> None:
        """Refuse what an asked score cannot take, and say which scores can."""
        side = min(image.shape[-2:])
        what = "the image" if self.args.bayer != PLANES else "a plane of the mosaic"
        side = side if self.args.bayer != PLANES else side // 2
        least = {name: IMAGE_SCORES[name].minimum for name in self.names}
        small = [f"{name} ({minimum})" for name, minimum in least.items() if minimum > side]
        if small:
            left = [name for name, minimum in least.items() if minimum <= side]
            raise TorchweatherError(
                f"{path}: {what} has {side} px on its short side, too few for {', '.join(small)}; "
                + (f"give --metrics {','.join(left)}." if left else "give other --metrics.")
            )

    def _refuse_options_of_mosaics(self, path: Path) -> None:
        for name in OF_MOSAICS:
            if getattr(self.args, name) is not None and not (name == "bayer" and self.args.bayer == GREY):
                option = "--" + name.replace("_", "-")
                raise TorchweatherError(f"{path}: {option} is for raw mosaics; this is a colour or grey image.")

    def _say(self, what: str, text: str) -> None:
        """Say something once, however many files it is true of."""
        if what not in self.said:
            self.said.add(what)
            note(text, quiet=self.args.quiet)


def plane_names(pattern: str) -> list[str]:
    """Names of the four planes of a mosaic in the order of the cell.

    Example:
        >>> plane_names("GRBG"), plane_names("RCCB")
        (['g1', 'r', 'b', 'g2'], ['r', 'c1', 'c2', 'b'])
    """
    colours = pattern.lower()
    names = [colour + str(colours[: place + 1].count(colour)) for place, colour in enumerate(colours)]
    return [name if colours.count(name[0]) > 1 else name[0] for name in names]


def _one_image(path: Path) -> Tensor:
    image, _ = read_image(path)
    if image.ndim != 3:
        raise TorchweatherError(
            f"{path}: expected one image (C, H, W); got {tuple(image.shape)}. Score them one by one."
        )
    return image


def _check_white(image: Tensor, white: float | None, path: Path) -> None:
    """Raise where values leave 0..white, or white is that of integers and the values are those of [0, 1]."""
    values = image if image.dtype != torch.uint16 else image.int()
    low, high = (float(value) for value in torch.aminmax(values))
    limit = float(torch.iinfo(image.dtype).max) if not image.is_floating_point() else UNIT
    limit = limit if white is None else white
    if not (low >= 0.0 and high <= limit):  # NaN too
        raise TorchweatherError(
            f"{path}: expected values from 0 to {limit:g} (white); got {low:g} to {high:g}. Give --white-level (or "
            "--bit-depth of a mosaic) if white is another value."
        )
    if image.is_floating_point() and limit > UNIT and 0.0 < high <= UNIT:
        raise TorchweatherError(
            f"{path}: --white-level is {limit:g}, but no value is above {high:g}: images in 0..1 have their white at 1."
        )


def _size(image: Tensor) -> str:
    channels, height, width = image.shape
    return f"{width} x {height} px with {'one value' if channels == 1 else f'{channels} colours'} per pixel"
