"""Public calls that are fuzzed: every public callable that has no place among the exceptions, and methods of objects."""

# ruff: noqa: E501, RUF005
from __future__ import annotations

import enum
import importlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch

from tests.fuzz import good_values as good
from tests.fuzz.good_values import BY_CALL, BY_NAME, CAMERA, LIDAR, RADAR
from tests.public_names import MODULES, names_of
from torchweather import physics
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.compose import Compose
from torchweather.core.distributions import Choice, LogUniform
from torchweather.pipeline.effect import Effect
from torchweather.radar import CellAveragingCfar
from torchweather.transforms import AsBayer, BayerWeather, LidarWeather, RadarAttenuation, RadarMapWeather

__all__ = ["Target", "targets"]

# What is not called at random: it runs for minutes, changes the process, needs a study, or only carries results.
LEFT_OUT = frozenset(
    # Runs of minutes, on whole data sets or studies.
    ["augment", "find_gap", "validate", "diagnose", "simulate", "run_robustness", "to_onnx", "fuse", "own_vehicle_mask"]
    + [
        "study_from_folders",
        "study_from_kitti",
        "fit_near_response",
        "GapReport",
        "Study",
        "Frame",
        "Frames",
        "Manifest",
    ]
    # Files of kinds that tests.fuzz.readers mutates.
    + ["read_ouster", "read_disdrometer", "read_declaration", "draft_declaration", "DepthNetwork", "OnnxDetector"]
    # What changes the process, or is there to be derived from.
    + [
        "register",
        "register_effect",
        "atomic_write",
        "atomic_folder",
        "Chain",
        "Subject",
        "Stage",
        "Effect",
        "DepthSource",
    ]
    # Checks and helpers of developers, whose own arguments are constants.
    + ["check_drawn", "check_intensities", "check_at_least", "check_between", "check_finite", "check_one_of"]
    + [
        "check_positive",
        "nearest_name",
        "least_sure",
        "State",
        "Mixture",
        "draw_feed",
        "judged",
        "columns_of",
        "series_of",
    ]
)
# Records that the package fills in; their fields are no input.
RECORDS = frozenset(
    [
        "CameraResult",
        "HdrResult",
        "LidarResult",
        "RadarResult",
        "RadarMapResult",
        "FmcwResult",
        "BeamEnds",
        "ScanPattern",
        "PatternFit",
        "NearResponseFit",
        "AveragePrecision",
        "Correlation",
        "MetricCorrelation",
        "Judgement",
        "Level",
        "Sample",
        "Series",
        "SeriesTrends",
        "ConditionResult",
        "Interval",
        "OperatingPoint",
        "Performance",
        "Rates",
        "RobustnessResult",
        "Validation",
        "Finding",
        "Hit",
        "LidarView",
        "RadarView",
        "SceneView",
        "Progress",
        "Row",
        "Summary",
        "ImageInfo",
        "MapRecord",
        "OusterFrame",
        "ExifFocal",
        "LabelFormat",
        "Horizon",
        "Sky",
        "DropSpectrum",
        "Table13Row",
        "SphereBudget",
        "MieEfficiencies",
        "RainCoefficients",
        "CameraState",
        "LidarState",
        "RadarState",
        "PowerMapState",
        "TransformRecipe",
        "MultiSensorRecipe",
        "SuiteRecipe",
        "Condition",
        "BoxVisibility",
        "StudyScene",
        "LabelledFrame",
        "BoxTruth",
        "LabelTruth",
        "Declaration",
        "Draw",
        "SceneObject",
        "Scene",
        "CornerReflector",
    ]
)
# Results that may hold infinity for finite inputs: a distance without bound, clear air, a score of equal images, sky.
INFINITE = frozenset(
    (
        "mor_from_extinction",  # clear air
        "mor_from_liquid_water_m",
        "weather_from_dict",
        "image_scores",  # of equal images
        "bayer_scores",
        "read_depth",  # sky, and what is unknown
        "depth_from_carla",
        "depth_from_disparity",
        "chamfer_distance",  # of clouds without points
        "cloud_scores",
        "average_precision",  # ranges without an end
        "correlate",  # what equal numbers leave undefined
        "fit_pattern",  # intervals of a ring that shows nothing
        "box_visibility",  # of a box without points
        "rates",
        "isosceles_triangle_rcs_m2",  # sides beyond the earth
        "Camera.distort",  # rays far beside the picture
        "RadarMapWeather.run",  # clutter of 0 W in dB
        "RadarAttenuation.run",  # signal of an empty row in dB
        "RadarClutter.run",  # signal of no detection in dB
        "project_boxes",  # of a box behind the camera
        "estimate_pattern",
    )
)

DISTRIBUTIONS = ("AnyDistribution", "SizeDistribution", "Exponential", "Gamma", "ModifiedGamma", "LogNormal")


@dataclass(frozen=True)
class Target:
    """A call, with what makes valid arguments for it.

    Args:
        group: module or kind, under which it is counted.
        name: of the call.
        call: the callable.
        arguments: parameter to what makes its value; those that have to be given.
        optional: further parameters, with what makes a valid value.
        finite: finite arguments must give finite results.
    """

    group: str
    name: str
    call: Callable[..., Any]
    arguments: Mapping[str, Callable[[], Any]]
    optional: Mapping[str, Callable[[], Any]]
    finite: bool = True


@cache
def targets() -> tuple[Target, ...]:
    """All calls, in a fixed order."""
    found: dict[str, Target] = {}
    seen: set[int] = set()
    for module in MODULES:
        for name in names_of(module):
            value = getattr(importlib.import_module(module), name)
            if not callable(value) or id(value) in seen or name in LEFT_OUT | RECORDS or not _plain(value):
                continue
            seen.add(id(value))
            group = module.removeprefix("torchweather.").split(".")[0] if "." in module else "torchweather"
            if isinstance(value, type) and issubclass(value, Effect):
                found[name] = _effect(name, value)
            elif target := _target(group, name, value):
                found[name] = target
    for owner, make in OBJECTS.items():
        for name in METHODS.get(owner, _methods(make())):
            call = _method(make, name)
            if target := _target("methods", f"{owner}.{name}", call, getattr(type(make()), name)):
                found[target.name] = target
    return tuple(found.values())


def _plain(value: Any) -> bool:
    if isinstance(value, type):
        return not issubclass(value, (enum.Enum, BaseException, Warning)) and not inspect.isabstract(value)
    return True


def _target(group: str, name: str, call: Callable[..., Any], signed: Any = None) -> Target | None:
    """The call, where every argument that it needs has a value."""
    try:
        parameters = inspect.signature(signed or call).parameters
    except (ValueError, TypeError):
        return None
    arguments: dict[str, Callable[[], Any]] = {}
    optional: dict[str, Callable[[], Any]] = {}
    last = name.rpartition(".")[2]
    for one in parameters.values():
        if one.name in ("self", "device") or one.kind in (one.VAR_KEYWORD, one.VAR_POSITIONAL):
            continue
        make = BY_CALL.get(f"{name}.{one.name}") or BY_CALL.get(f"{last}.{one.name}") or BY_NAME.get(one.name)
        if one.default is not one.empty and f"{name}.{one.name}" not in BY_CALL:
            optional[one.name] = make if make and one.default is None else lambda default=one.default: default
        else:
            arguments[one.name] = make or _by_annotation(str(one.annotation))
    # Size distributions may have no largest diameter.
    returns = str(getattr(inspect.signature(signed or call), "return_annotation", "")).strip("'")
    finite = not {name, last} & INFINITE and returns not in DISTRIBUTIONS and not isinstance(call, type)
    return Target(group, name, call, arguments, optional, finite=finite)


def _by_annotation(text: str) -> Callable[[], Any]:
    kinds: dict[str, Callable[[], Any]] = {
        "float": lambda: 1.5,
        "int": lambda: 3,
        "str": lambda: "a",
        "bool": lambda: True,
        "Quantity": lambda: 1.5,
        "Tensor": lambda: torch.rand(4),
        "Mapping": dict,
        "Sequence": lambda: [1.0, 2.0],
        "tuple": lambda: (1.0, 2.0),
        "Path": lambda: good.folder(),
        "Callable": lambda: lambda value: value,
        "Given": lambda: 5.0,
        "Values": lambda: (1.0, 5.0),
    }
    return next((make for start, make in kinds.items() if text.startswith(start)), object)


def _effect(name: str, kind: type[Effect]) -> Target:
    given = {one.name: (lambda one=one: one.value) for one in kind.arguments}
    return Target("effects", name, kind, {}, given, finite=False)


def _methods(one: Any) -> list[str]:
    own = vars(type(one)) if type(one).__module__.startswith("torchweather") else {}
    skip = ("extra_repr", "save", "forget_rays", "weathered", "truth_of", "planes_state", "sequence_of")
    return [name for name, value in own.items() if inspect.isfunction(value) and name[0] != "_" and name not in skip]


def _method(make: Callable[[], Any], name: str) -> Callable[..., Any]:
    def call(**arguments: Any) -> Any:
        found = getattr(make(), name)(**arguments)
        return next(found) if inspect.isgenerator(found) else found

    return call


# Built once: a transform remembers nothing of a call.
OBJECTS: dict[str, Callable[[], Any]] = {
    "Camera": cache(lambda: CAMERA),
    "Lidar": cache(lambda: LIDAR),
    "Radar": cache(lambda: RADAR),
    "BayerRain": cache(lambda: BayerWeather(Rain(10.0), CAMERA, depth=20.0)),
    "BayerSnow": cache(lambda: BayerWeather(Mixture(Snow(1.0), Fog(60.0)), CAMERA, depth=20.0)),
    "BayerFog": cache(lambda: BayerWeather(Fog(50.0), CAMERA, depth=20.0)),
    "AsBayer": cache(lambda: AsBayer(BayerWeather(Fog(50.0), CAMERA, depth=20.0))),
    "LidarRain": cache(lambda: LidarWeather(Rain(10.0), LIDAR)),
    "LidarSnow": cache(lambda: LidarWeather(Mixture(Snow(1.0), Fog(60.0)), LIDAR)),
    "RadarAttenuation": cache(lambda: RadarAttenuation(Rain(10.0), RADAR)),
    "RadarClutter": cache(lambda: RadarAttenuation(Rain(10.0), RADAR, clutter=True)),
    "RadarMapWeather": cache(
        lambda: RadarMapWeather(
            Rain(10.0), RADAR, axes=good.AXES, scale=good.PowerScale.steps(0.5), noise_floor_db=20.0
        )
    ),
    "Compose": cache(lambda: Compose({"points": LidarWeather(Rain(10.0), LIDAR)}, weather=Rain((1.0, 20.0)))),
    "Exponential": cache(lambda: physics.marshall_palmer(10.0)),
    "Gamma": cache(lambda: physics.brandes_snow(1.0)),
    "LogNormal": cache(lambda: physics.default_fog(50.0)),
    "Choice": cache(lambda: Choice([1.0, 2.0])),
    "LogUniform": cache(lambda: LogUniform(1.0, 10.0)),
    "Mixture": cache(lambda: Mixture(Rain((1.0, 5.0)), Fog(60.0))),
    "MapAxes": cache(lambda: good.AXES),
    "Cfar": cache(lambda: CellAveragingCfar()),
    "Boxes": cache(good.boxes),
}
_CALLS = ("forward", "run", "draw", "state_of")
METHODS = {
    "BayerRain": (*_CALLS, "draw_sequence", "at_ego_speed", "with_weather"),
    "BayerSnow": _CALLS,
    "BayerFog": (*_CALLS, "scene_of"),
    "AsBayer": ("forward", "run", "draw", "with_weather"),
    "LidarRain": (*_CALLS, "expected", "on_numpy", "with_weather"),
    "LidarSnow": _CALLS,
    "RadarAttenuation": (*_CALLS, "on_numpy"),
    "RadarClutter": ("run", "draw"),
    "RadarMapWeather": ("forward", "run", "draw", "of_map"),
    "Compose": ("forward", "run", "draw"),
    "Camera": (
        "cropped",
        "fitted_to",
        "resized",
        "distort",
        "undistort",
        "magnification",
        "ray_directions",
        "from_intrinsics",
        "from_field_of_view",
        "preset",
        "from_dict",
    ),
    "Lidar": ("with_pose", "near_response", "preset", "from_dict"),
    "Radar": ("gain_dbi", "preset", "from_dict"),
    "Exponential": ("number_density_per_m3_mm", "moment", "sample_diameter_mm", "scaled", "within"),
    "Gamma": ("number_density_per_m3_mm", "moment", "sample_diameter_mm"),
    "LogNormal": ("number_density_per_m3_mm", "moment", "sample_diameter_mm"),
    "MapAxes": ("of_turn", "axis"),
    "Cfar": ("threshold",),
}
assert Path
