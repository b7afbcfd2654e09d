"""ExposureMeter and ExposureControl: a camera that keeps the brightness of its picture, whatever the weather."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.camera.state import CameraState
from torchweather.core.arguments import check_arguments, check_options
from torchweather.core.errors import InputValueError, check_at_least, check_between, check_one_of
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage

__all__ = ["EXPOSURE_CONTROLS", "FULL_WINDOW", "ExposureControl", "ExposureMeter", "as_exposure_control", "metered"]

EXPOSURE_CONTROLS = ("mean", "median")
"""Statistics of the metering window that a control keeps."""
FULL_WINDOW = (0.0, 0.0, 1.0, 1.0)
MEDIAN_STEP_PX = 4  # the median is taken over every fourth cell of two pixels in both directions
DARKEST = 1e-6  # of saturation: a darker frame asks for the largest gain


def metered(state: CameraState, statistic: str, window: Sequence[float] = FULL_WINDOW) -> Tensor:
    """Mean or median signal of a window of the frame, ``(B,)``, linear.

    Args:
        state: the frame.
        statistic: ``mean`` or ``median``.
        window: top, left, bottom, right as shares of height and width; whole cells of two pixels are taken.
    """
    height, width = state.image.signal.shape[-2:]
    top, left, bottom, right = window
    inside = state.image.signal[..., _cells(height, top, bottom), _cells(width, left, right)]
    if statistic == "mean":
        return inside.flatten(1).mean(1)
    step = 2 * MEDIAN_STEP_PX
    cells = [inside[..., row::step, column::step].flatten(1) for row in (0, 1) for column in (0, 1)]
    ordered = torch.cat(cells, 1).sort(1).values
    return ordered[:, ordered.shape[1] // 2]


def _cells(size: int, first: float, last: float) -> slice:
    """Pixels from one share of a side to another, at least one cell of two pixels."""
    start = int(size * first) // 2 * 2
    return slice(start, max(start + 2, int(size * last) // 2 * 2))


class _Metering(Stage):
    """A statistic of a window, as meter and control share it."""

    def __init__(self, statistic: str = "mean", window: Sequence[float] = FULL_WINDOW) -> None:
        super().__init__()
        check_one_of("statistic", statistic, EXPOSURE_CONTROLS, owner=self)
        self.statistic, self.window = statistic, _checked_window(window, self)

    def metered(self, state: CameraState) -> Tensor:
        """The statistic, ``(B,)``."""
        return metered(state, self.statistic, self.window)


@register
class ExposureMeter(_Metering):
    """Target of the exposure control: a statistic of the frame before the weather.

    Identity: it changes no pixel.

    Args:
        statistic: ``mean`` or ``median``.
        window: top, left, bottom, right as shares of height and width.
    """

    default_name: ClassVar[str] = "exposure_meter"
    reads: ClassVar[tuple[str, ...]] = ("image.signal",)
    writes: ClassVar[tuple[str, ...]] = ("receiver.metered_signal",)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"statistic": self.statistic, "window": list(self.window)}

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The state with its statistic."""
        return state.changed(metered_signal=self.metered(state))


@register
class ExposureControl(_Metering):
    """Exposure time and gain follow the light: the frame gets the mean or median back that it had without weather.

    Cameras keep their mean: against recordings of fog a frame without control is too bright by up to a factor of two
    (``PHYSICS.md`` 10.6). The gain acts on linear light, in front of noise, saturation and quantisation. Streaks keep
    the length of the camera's own exposure time: the control is taken for one of gain, not of time.

    Identity: a frame whose statistic is unchanged.

    Args:
        statistic: ``mean`` or ``median``.
        window: top, left, bottom, right as shares of height and width.
        target: statistic to aim at, linear, above 0 to 1; ``None`` is that of the frame before the weather, which an
            ``ExposureMeter`` with the same window measures.
        lowest_gain, highest_gain: limits of the gain.

    Example:
        >>> from torchweather.camera.transform import BayerFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> from torchweather.sensors import Camera
        >>> camera = Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
        >>> frame = torch.rand(1, 24, 32, generator=torch.Generator().manual_seed(1)) * 0.2
        >>> fog = {"weather": Fog(mor_m=30), "camera": camera, "depth": 40.0, "airlight": 0.7}
        >>> means = [BayerFog(**fog, exposure_control=one)(frame).mean() for one in (None, "mean")]
        >>> [round(float(mean / frame.mean()), 2) for mean in means]
        [6.86, 1.0]
    """

    default_name: ClassVar[str] = "exposure_control"
    reads: ClassVar[tuple[str, ...]] = ("image.signal", "receiver.metered_signal")
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def __init__(
        self,
        statistic: str = "mean",
        window: Sequence[float] = FULL_WINDOW,
        target: float | None = None,
        lowest_gain: float = 0.125,
        highest_gain: float = 8.0,
    ) -> None:
        super().__init__(statistic, window)
        check_arguments(
            "ExposureControl(target: float | None, lowest_gain: float, highest_gain: float)",
            target,
            lowest_gain,
            highest_gain,
        )
        if target is not None:
            check_between("target", target, 1e-4, 1.0, unit="of saturation", owner=self)
        check_between("lowest_gain", lowest_gain, 1e-3, 1.0, owner=self)
        check_at_least("highest_gain", highest_gain, 1.0, owner=self)
        self.target, self.lowest_gain, self.highest_gain = target, float(lowest_gain), float(highest_gain)

    def meter(self) -> ExposureMeter:
        """The meter of the clear frame that belongs to it."""
        return ExposureMeter(self.statistic, self.window)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "statistic": self.statistic,
            "window": list(self.window),
            "target": self.target,
            "lowest_gain": self.lowest_gain,
            "highest_gain": self.highest_gain,
        }

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The frame with its gain."""
        now = self.metered(state).clamp_min(DARKEST)
        if self.target is not None:
            wanted = torch.full_like(now, self.target)
        elif state.receiver.metered_signal is not None:
            wanted = state.receiver.metered_signal.to(now).clamp_min(DARKEST)
        else:
            raise InputValueError(
                "ExposureControl: expected a target, or an ExposureMeter before the weather; this chain has neither."
            )
        gain = (wanted / now).clamp(self.lowest_gain, self.highest_gain)
        return state.changed(signal=(state.image.signal * gain.view(-1, 1, 1, 1)).clamp_max(1.0))


def as_exposure_control(value: str | ExposureControl | Mapping[str, Any], owner: object) -> ExposureControl:
    """A control from the name of its statistic, from its arguments, or itself."""
    if isinstance(value, ExposureControl):
        return value
    if isinstance(value, Mapping):
        check_options("exposure_control", ExposureControl, value)
        return ExposureControl(**value)
    if not isinstance(value, str) or value not in EXPOSURE_CONTROLS:
        raise InputValueError(
            f"{type(owner).__name__}: exposure_control must be None, {', '.join(map(repr, EXPOSURE_CONTROLS))} or an "
            f"ExposureControl; got {value!r}."
        )
    return ExposureControl(value)


def _checked_window(window: Sequence[float], owner: object) -> tuple[float, float, float, float]:
    check_arguments("exposure_window(window: Sequence[float])", window)
    values = tuple(float(value) for value in window)
    if len(values) != 4 or not (0 <= values[0] < values[2] <= 1 and 0 <= values[1] < values[3] <= 1):
        raise InputValueError(
            f"{type(owner).__name__}: window must be (top, left, bottom, right) as shares of height and width, each "
            f"0 to 1, top above bottom and left of right; got {tuple(window)!r}."
        )
    return values
