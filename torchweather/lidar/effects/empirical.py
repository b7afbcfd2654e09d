"""Empirical: a measured departure put on a LiDAR's points as it was measured, without a cause."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between, check_one_of
from torchweather.core.random import Variate
from torchweather.lidar.effects.air import along_beam
from torchweather.lidar.effects.receiver import CROSSTALK_MARGIN_DB
from torchweather.lidar.stages import DB, exponential
from torchweather.lidar.state import LidarState
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage

__all__ = ["AXES", "KINDS", "Empirical"]

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))

KINDS: dict[str, tuple[str, ...]] = {
    "intensity": ("object", "particle"),
    "intensity_noise": ("object", "particle"),
    "loss": ("object",),
    "range": ("object",),
    "range_noise": ("object",),
    "returns": ("object", "empty"),
}
"""Operations of the curve, by the quantity that each acts on."""
AXES = (
    *("range_m", "azimuth_rad", "elevation_rad", "cos_incidence", "up", "margin_db", "log_intensity"),
    *("particle_range_m", "every_beam"),
)
"""Along what the curve goes."""
# Least and most that the curve may say of each kind.
LIMITS = {
    "loss": (-1.0, 1.0),
    "returns": (0.0, 1.0),
    "range_noise": (0.0, math.inf),
    "intensity_noise": (0.0, math.inf),
}
NOISE = {
    "loss": (Variate("toss", "uniform", ("N",)),),
    "range_noise": (Variate("error", "normal", ("N",)),),
    "intensity_noise": (Variate("error", "normal", ("N",)),),
    "returns": tuple(Variate(name, "uniform", ("N",)) for name in ("hit", "place", "margin")),
}
FAINTEST = 1e-6  # of an intensity in a logarithm, as the gap's statistics have it
NARROWEST = 1e-12  # width of a piece of the curve


@register
class Empirical(Stage):
    """A measured curve over an axis, put on what the sensor reports. It has no cause and is no effect of the catalogue.

    Between two nodes the curve is straight, between the first and the last node and the ends of the measured range it
    is level. **Outside the measured range the stage does nothing**, nor does it know other weather, scenes or sensors
    than those it was measured in. Where the curve is 0 every bit stays.

    Args:
        kind: what the curve says:

            - ``intensity``: natural logarithm of a factor on the intensities of returns;
            - ``intensity_noise``: standard deviation of a normal error of the logarithm of an intensity;
            - ``loss``: probability that a return is dropped; below 0, that a lost return comes back, at the threshold;
            - ``range``: offset of the range, m;
            - ``range_noise``: standard deviation of a normal error of the range, m;
            - ``returns``: probability that a beam reports an added return instead of what it sees.
        axis: of the beam's surface in clear air ``range_m``, ``cos_incidence``, ``up``, ``log_intensity``,
            ``margin_db`` (over the detection threshold); of the beam ``azimuth_rad``, ``elevation_rad``,
            ``every_beam`` (all alike, at 0); of a return ``particle_range_m``.
        at: ``(K,)`` nodes along the axis, rising.
        value: ``(K,)`` the curve at the nodes.
        measured_from, measured_to: ends of the measured range.
        of: ``object`` (returns of surfaces, beams that see one), ``particle``, or ``empty`` (beams that see nothing).
        places_m: ``(P + 1,)`` edges of ranges of added returns, m; for ``returns``. In front of a surface only those
            nearer than it are added.
        shares: ``(P,)`` share of the added returns in each of them.

    Note:
        The last stage before the points are made. The signal is multiplied, which is the intensity in every unit but
        the logarithmic part of ``uint8_calibrated``. Added returns are particles with an exponential margin over the
        threshold of 3 dB in the mean.

    References:
        GAP.md 3 (9).

    Example:
        >>> Empirical("range", "range_m", [10.0, 50.0], [0.0, 0.04], 5.0, 80.0)
        Empirical(range of object over range_m, 5 to 80)
    """

    default_name: ClassVar[str] = "empirical"
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        "scene.clear_range_m",
        "scene.clear_signal",
        "scene.cos_incidence",
        "scene.empty_direction",
        "scene.points_in",
        "scene.up",
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.threshold", "receiver.threshold_scale"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.range_m", "returns.signal")
    at: Tensor
    value: Tensor
    cumulated: Tensor
    places: Tensor

    def __init__(
        self,
        kind: str,
        axis: str,
        at: Sequence[float],
        value: Sequence[float],
        measured_from: float,
        measured_to: float,
        of: str = "object",
        places_m: Sequence[float] = (),
        shares: Sequence[float] = (),
    ) -> None:
        check_arguments(
            "Empirical(kind: str, axis: str, at: Sequence[float], value: Sequence[float], measured_from: float, "
            "measured_to: float, of: str, places_m: Sequence[float], shares: Sequence[float])",
            kind,
            axis,
            at,
            value,
            measured_from,
            measured_to,
            of,
            places_m,
            shares,
        )
        super().__init__()
        check_one_of("kind", kind, KINDS, owner=self)
        check_one_of("axis", axis, AXES, owner=self)
        check_one_of("of", of, KINDS[kind], owner=self)
        if axis == "particle_range_m" and of != "particle":
            raise InputValueError(
                "Empirical: axis particle_range_m is the range of a particle; expected of='particle'."
            )
        nodes = [float(one) for one in at]
        _check_rising("at", [float(measured_from), *nodes, float(measured_to)])
        if not nodes or len(nodes) != len(value):
            raise InputValueError(
                f"Empirical: expected one value for each node, one or more; got {len(nodes)}, {len(value)}."
            )
        low, high = LIMITS.get(kind, (-math.inf, math.inf))
        for one in value:
            check_between(f"value of {kind}", float(one), low, high, owner=self)
            if not math.isfinite(float(one)):
                raise InputValueError(f"Empirical: value must be finite; got {one}.")
        if (kind == "returns") != bool(len(shares)):
            raise InputValueError("Empirical: places_m and shares belong to kind 'returns', which needs both.")
        self.kind, self.axis, self.of = kind, axis, of
        self.measured_from, self.measured_to = float(measured_from), float(measured_to)
        self._given = (nodes, [float(one) for one in value])
        # Level from the ends of the measured range to the nodes next to them.
        ends = [self.measured_from, *nodes, self.measured_to]
        self.register_buffer("at", torch.tensor(ends, dtype=torch.float32))
        self.register_buffer("value", torch.tensor([value[0], *value, value[-1]], dtype=torch.float32))
        self.places_m, self.shares = [float(one) for one in places_m], [float(one) for one in shares]
        self._make_places()

    def _make_places(self) -> None:
        """Ranges of added returns over the share of those that are nearer."""
        if self.kind != "returns":
            return
        _check_rising("places_m", self.places_m)
        if len(self.places_m) != len(self.shares) + 1 or min(self.places_m) < 0:
            raise InputValueError("Empirical: expected places_m of 0 m or more, one more than shares.")
        total = sum(self.shares)
        if min(self.shares) < 0 or not 0 < total < math.inf:
            raise InputValueError("Empirical: shares must be 0 or more, and not all 0.")
        cumulated = [0.0, *itertools.accumulate(share / total for share in self.shares)]
        cumulated[-1] = 1.0
        self.register_buffer("cumulated", torch.tensor(cumulated, dtype=torch.float32))
        self.register_buffer("places", torch.tensor(self.places_m, dtype=torch.float32))

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        at, value = self._given
        found: dict[str, Any] = {
            "kind": self.kind,
            "axis": self.axis,
            "of": self.of,
            "at": at,
            "value": value,
            "measured_from": self.measured_from,
            "measured_to": self.measured_to,
        }
        if self.kind == "returns":
            found |= {"places_m": self.places_m, "shares": self.shares}
        return found

    def extra_repr(self) -> str:
        """Quantity, axis and measured range."""
        return f"{self.kind} of {self.of} over {self.axis}, {self.measured_from:g} to {self.measured_to:g}"

    def variates(self) -> tuple[Variate, ...]:
        """Numbers of each beam, where the kind is random."""
        return NOISE.get(self.kind, ())

    def curve(self, coordinate: Tensor) -> Tensor:
        """The curve at coordinates of any shape; 0 outside the measured range."""
        return _piecewise(coordinate, self.at, self.value)

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with the curve put on its reported returns."""
        coordinate = self._coordinate(state)
        curve = self.curve(coordinate if self.axis == "particle_range_m" else coordinate[..., None])
        if self.kind == "returns":
            return self._with_returns(state, curve[..., 0], noise)
        chosen = state.returns.kind == (OBJECT if self.of == "object" else PARTICLE)
        if self.kind == "loss":
            return self._with_losses(state, curve, chosen, noise["toss"].to(curve)[..., None])
        amount = curve * noise["error"].to(curve)[..., None] if self.kind.endswith("noise") else curve
        here = chosen & (amount != 0)
        if self.kind.startswith("intensity"):
            return state.changed(signal=torch.where(here, state.returns.signal * amount.exp(), state.returns.signal))
        return state.changed(
            range_m=torch.where(here, (state.returns.range_m + amount).clamp_min(0.0), state.returns.range_m)
        )

    def _coordinate(self, state: LidarState) -> Tensor:
        """Where each beam is on the axis, ``(1 or B, N)``, or each return, ``(B, N, E)``."""
        if self.axis == "particle_range_m":
            return state.returns.range_m
        if self.axis == "range_m":
            return state.scene.clear_range_m
        if self.axis == "every_beam":
            return torch.zeros_like(state.scene.clear_range_m)
        if self.axis == "log_intensity":
            return state.scene.points_in[..., 3].clamp_min(FAINTEST).log()
        if self.axis == "margin_db":
            return (state.scene.clear_signal / state.receiver.threshold).clamp_min(FAINTEST).log() / DB
        if self.axis in ("cos_incidence", "up"):
            found: Tensor | None = state.field(self.axis)
            if found is None:
                raise InputValueError(
                    f"Empirical: expected a state with {self.axis}, over which the curve was measured; this one has "
                    "none."
                )
            return found.abs() if self.axis == "cos_incidence" else found
        x, y, z = along_beam(state)
        if self.axis == "azimuth_rad":
            return torch.atan2(y, x)
        return torch.atan2(z, (x * x + y * y).sqrt())

    @staticmethod
    def _with_losses(state: LidarState, curve: Tensor, chosen: Tensor, tossed: Tensor) -> LidarState:
        dropped = chosen & (tossed < curve)
        seen = (state.scene.clear_range_m > 0)[..., None]
        first = torch.arange(state.returns.kind.shape[-1], device=state.returns.kind.device) == 0
        back = (state.returns.kind == LOST) & seen & first & (tossed < -curve)
        threshold = state.detected_from
        threshold = threshold[..., None] if threshold.ndim else threshold
        range_m = torch.where(
            back, state.scene.clear_range_m[..., None], torch.where(dropped, 0.0, state.returns.range_m)
        )
        signal = torch.where(back, threshold, torch.where(dropped, 0.0, state.returns.signal))
        kind = torch.where(back, OBJECT, torch.where(dropped, LOST, state.returns.kind)).to(torch.int8)
        return state.changed(range_m=range_m, signal=signal, kind=kind)

    def _with_returns(self, state: LidarState, curve: Tensor, noise: Mapping[str, Tensor]) -> LidarState:
        """The first reported return, replaced where a beam has an added one."""
        like = state.scene.clear_range_m
        hit, place, margin = (noise[name].to(like) for name in ("hit", "place", "margin"))
        range_m = _piecewise(place, self.cumulated, self.places)
        if self.of == "object":
            there = (range_m > 0) & (range_m < like)
        else:
            there = (range_m > 0) & (like == 0)
            direction = state.scene.empty_direction
            there = there & (direction != 0).any(-1) if direction is not None else torch.zeros_like(there)
        added = there & (hit < curve)
        new = {
            "range_m": range_m,
            "signal": state.detected_from * torch.exp(DB * CROSSTALK_MARGIN_DB * exponential(margin)),
            "kind": torch.full_like(state.returns.kind[..., 0], PARTICLE),
        }
        changed: dict[str, Any] = {}
        for name, value in new.items():
            echoes = state.field(name)
            first = torch.where(added, value.to(echoes.dtype), echoes[..., 0])
            changed[name] = torch.cat([first[..., None], echoes[..., 1:]], -1)
        return state.changed(**changed)


def _piecewise(x: Tensor, at: Tensor, value: Tensor) -> Tensor:
    """Straight lines between nodes, 0 outside them; piece by piece, so that a level piece keeps its own bits."""
    found = torch.zeros_like(x)
    nodes, values = at.to(x).unbind(), value.to(x).unbind()
    last = len(nodes) - 2
    for place, ((low, high), (start, end)) in enumerate(
        zip(itertools.pairwise(nodes), itertools.pairwise(values), strict=True)
    ):
        inside = (x >= low) & ((x <= high) if place == last else (x < high))
        share = (x - low) / (high - low).clamp_min(NARROWEST)
        found = torch.where(inside, start + (end - start) * share, found)
    return found


def _check_rising(name: str, values: Sequence[float]) -> None:
    finite = all(math.isfinite(one) for one in values)
    if not finite or any(later < earlier for earlier, later in itertools.pairwise(values)):
        raise InputValueError(
            f"Empirical: {name} must be finite and rise, within measured_from and measured_to; got {list(values)}."
        )
