"""Breaks of the embedded scenes."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

HALLS = "tests/scenes/test_rehearse_halls.py"

MUTANTS = (
    Mutant(
        "rain_field_left_at_its_last_face",
        "a ray leaves a box at the nearest of the three far faces",
        "torchweather.scenes.rain_field",
        "torch.maximum(first, second).amin(-1)",
        "torch.maximum(first, second).amax(-1)",
        (f"{HALLS}::test_the_field_is_what_marching_along_the_rays_finds",),
    ),
    Mutant(
        "hall_as_long_as_its_rain_field",
        "the rain field of THI's hall is 50 m long and does not fill it",
        "torchweather.scenes.thi_hall",
        "(50.0, 2.5, NOZZLE_HEIGHT_M)",
        "(118.0, 2.5, NOZZLE_HEIGHT_M)",
        (f"{HALLS}::test_the_halls_have_their_published_size",),
    ),
)
