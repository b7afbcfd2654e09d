"""Sizes of pictures: whether they show the same view, and what fitting one to the other does."""

from __future__ import annotations

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between

__all__ = ["same_aspect", "size_change"]

# Two sizes whose aspect ratios differ by less are one picture in two sizes: rounding to whole pixels leaves up to
# 0.8 % on the smallest frames in use here (32 x 24 of 1936 x 1464 px); 16:10 against 16:9 is 11 %.
SAME_ASPECT = 0.01


def same_aspect(width: float, height: float, other_width: float, other_height: float) -> bool:
    """True where two sizes have one aspect ratio within 1 %.

    Example:
        >>> same_aspect(1936, 1464, 242, 184), same_aspect(1936, 1464, 1242, 375)
        (True, False)
    """
    check_arguments(
        "same_aspect(width: float, height: float, other_width: float, other_height: float)",
        width,
        height,
        other_width,
        other_height,
    )
    sizes = {"width": width, "height": height, "other_width": other_width, "other_height": other_height}
    for name, value in sizes.items():
        check_between(name, value, 1e-6, 1e9, owner="same_aspect")
    return abs(width * other_height / (height * other_width) - 1) <= SAME_ASPECT


def size_change(width: int, height: int, other_width: int, other_height: int) -> str:
    """Change of a picture of one size into another: ``same``, ``scaled``, ``turned``, ``cropped`` or ``extended``.

    Example:
        >>> size_change(1936, 1464, 1242, 375), size_change(1936, 1464, 968, 732), size_change(1936, 1464, 732, 968)
        ('cropped', 'scaled', 'turned')
    """
    if (width, height) == (other_width, other_height):
        return "same"
    if same_aspect(other_width, other_height, width, height):
        return "scaled"
    if (other_width - other_height) * (width - height) < 0:
        return "turned"
    return "cropped" if other_width * height > width * other_height else "extended"
