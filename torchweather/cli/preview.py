"""Preview pages of ``torchweather apply --preview``: a slider for images, points in WebGL for clouds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor

    from torchweather.atmosphere.weather import Weather
    from torchweather.camera.depth import SceneDepth

__all__ = ["preview_image", "severities"]

STEP = 4.0  # factor of rate or visibility from one severity to the next
HIGHEST_MM_PER_H = {"rain": 100.0, "snow": 10.0}  # that a draw holds unless told


def severities(weather: Weather) -> list[tuple[str, Weather]]:
    """The weather as it is, a lighter and a heavier one: a quarter and four times the rate, four times and a quarter of
    the visibility.

    Example:
        >>> from torchweather.atmosphere.weather import Fog
        >>> [(name, one.mor_m) for name, one in severities(Fog(mor_m=200.0))]
        [('as applied', 200.0), ('lighter', 800.0), ('heavier', 50.0)]
    """
    return [("as applied", weather), ("lighter", _scaled(weather, 1 / STEP)), ("heavier", _scaled(weather, STEP))]


def _scaled(weather: Weather, factor: float) -> Weather:
    """The weather with its rates times a factor, and its visibilities divided by it."""
    from torchweather.atmosphere.weather import Mixture

    parts = []
    for part in weather.parts:
        intensity = float(getattr(part, part.intensity_name))
        value = (
            intensity / factor
            if part.kind == "fog"
            else min(intensity * factor, max(intensity, HIGHEST_MM_PER_H[part.kind]))
        )
        parts.append(replace(part, **{part.intensity_name: value}))  # type: ignore[type-var]
    return parts[0] if len(parts) == 1 and not weather.conditions else Mixture(*parts, *weather.conditions)


def preview_image(
    path: Path, image: Tensor, transform: Any, scene: SceneDepth, seed: int, *, airlight_given: bool, name: str
) -> None:
    """Write the page of one image in three severities.

    Args:
        path: of the page.
        image: ``(3, H, W)`` sRGB, or a mosaic ``(1, H, W)``, which is developed.
        transform: of the weather that was applied.
        scene: depth of the image.
        seed: of the weather.
        airlight_given: whether the airlight was an argument.
        name: of the image.
    """
    from torchweather.report.before_after import panel_caption, write_before_after

    weather = transform.transform.weather if hasattr(transform, "transform") else transform.weather
    show = _shower(image, transform, scene)
    panels = []
    for title, one in severities(weather):
        made = transform if one is weather else transform.with_weather(one)
        result = made.run(image, scene, made.draw(image, seed=seed))
        seen = show(result.rgb if hasattr(result, "rgb") else result.bayer)
        caption = panel_caption(
            one,
            seed=seed,
            confidence=result.depth_confidence,
            airlight=result.airlight.tolist(),
            airlight_from="given" if airlight_given else "estimated from the picture",
        )
        panels.append((title, caption, seen))
    write_before_after(path, show(image), panels, title=name, notes=list(scene.notes))


def _shower(image: Tensor, transform: Any, scene: SceneDepth) -> Any:
    """Function from an image to an 8-bit picture ``(3, H, W)``: a mosaic is developed as the clear one looks best."""
    import torch

    from torchweather.camera.tone import normalise, quantise

    if image.shape[-3] == 3:
        return lambda data: data if data.dtype == torch.uint8 else quantise(normalise(data), torch.uint8)
    from torchweather.camera.levels import raw_to_linear
    from torchweather.report.pictures import look_of

    camera = transform.camera
    look = look_of(raw_to_linear(image, camera, "preview"), scene.depth_m.reshape(1, *image.shape[-2:]), camera)

    def developed(data: Tensor) -> Tensor:
        linear = raw_to_linear(data, camera, "preview")
        return quantise(look.develop(linear, camera.bayer_pattern), torch.uint8)

    return developed
