"""The answer of the search for a missing effect in sentences: the verdict, names, numbers with units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from torchweather.gap.inference.held_out import excess_left
from torchweather.gap.natural_units import DB_PER_NEPER
from torchweather.pipeline.effect import Parameter
from torchweather.report.tables import number_text, signed_text
from torchweather.stages.catalogue import EFFECTS

__all__ = [
    "WHOLE",
    "along",
    "axis_name",
    "bound_sentence",
    "confidence_text",
    "curve_unit",
    "edge_text",
    "effect_name",
    "exact_twins",
    "excess_text",
    "formula_words",
    "gap_sentence",
    "group_name",
    "headline",
    "listed",
    "parameter_name",
    "parameter_rows",
    "posterior_text",
    "probability_text",
    "signed_decimal",
    "signed_text",
    "statistic_name",
    "verdict_sentence",
]

STATISTICS = {
    "lost_share": "Beams that lost their return",
    "new_share": "Beams that return in front of their surface",
    "new_share_of_empty_beams": "Returns of beams that see nothing in clear air",
    "beyond_share": "Beams that return behind their surface",
    "log_intensity_ratio": "Intensity over clear air's",
    "log_intensity_spread": "Spread of intensity over clear air's",
    "zero_intensity_share": "Beams whose return has the intensity 0",
    "zero_intensity_share_of_particles": "Particle returns with the intensity 0",
    "range_residual_m": "Range less clear air's",
    "range_residual_spread": "Spread of range less clear air's",
    "particles_before_objects": "Particle returns in front of surfaces",
    "particles_of_empty_beams": "Particle returns in front of the sky",
    "clustered_share": "Particle returns with a neighbour",
    "log_particle_intensity": "Intensity of particle returns",
    "log_particle_intensity_spread": "Spread of the intensity of particle returns",
    "lost_share_of_thin_targets": "Beams that lost their return, thin targets beside others",
    "particle_root": "Number of particle returns",
    "near_particle_root": "Number of near particle returns",
    "particles": "Map of the particle returns",
    "attenuation_db": "Attenuation",
    "attenuation_after_rain_db": "Attenuation after rain",
    "lost_target_share": "Targets that are not detected",
    "lost_flickering_share": "Targets that flicker in clear air and are not detected",
    "power_residual_db": "Power over clear air's and the modelled loss",
    "power_spread": "Spread of power over clear air's",
    "speed_residual_m_per_s": "Speed less clear air's",
    "speed_spread": "Spread of speed over clear air's",
    "speed_far_off_share": "Targets with a speed far from clear air's",
    "repeated_power_share": "Targets with the same power as another",
    "repeated_range_share": "Targets with the same range as another",
    "repeated_speed_share": "Targets with the same speed as another",
    "range_error_m": "Range less clear air's",
    "range_spread": "Spread of range over clear air's",
    "range_drift_m": "Drift of range over the frames",
    "noise_floor_share": "Frames by how far their noise floor is higher",
    "clutter_count": "Detections beside the targets",
    "clutter_snr_db": "Power over the floor of detections beside the targets",
    "clutter_speed_m_per_s": "Speed of detections beside the targets",
    "clutter_speed_spread": "Spread of the speed of detections beside the targets",
    "ghost_count": "Detections behind a target at its speed",
    "log_ghost_delay": "How far detections lie behind their target",
    "ghost_power_db": "Power of detections behind a target over that of the target",
    "detections_root": "Number of detections",
    "clutter_root": "Number of detections beside the targets",
    "log_ratio_red": "Red light over clear air's",
    "log_ratio_green": "Green light over clear air's",
    "log_ratio_blue": "Blue light over clear air's",
    "log_ratio_spread": "Spread of light over the model",
    "log_ratio_map": "Map of light over clear air's",
    "lone_pixel_map": "Single pixels that stand out",
    "near_log_ratio": "Light from near by over clear air's",
    "far_log_ratio": "Light from far over clear air's",
    "sky_log_ratio": "Light of the sky over clear air's",
    "log_difference_spread": "Noise",
    "difference_spread": "Noise of pixels apart by",
    "edge_contrast": "Contrast across edges, pixels apart by",
    "streak_correlation": "Likeness of pixels apart by",
    "column_correlation": "Likeness of pixels far apart in a column",
    "row_correlation": "Likeness of pixels far apart in a row",
    **{
        f"shift_{way}_px_{colour}": f"Displacement of {colour} light {words}, px"
        for way, words in (("across", "to the right"), ("down", "downward"), ("outward", "outward, at the corners"))
        for colour in ("red", "green", "blue")
    },
    "bright_share_near": "Pixels brighter than those beside them, near by",
    "bright_share_far": "Pixels brighter than those beside them, far",
    "dark_share_near": "Pixels darker than those beside them, near by",
    "dark_share_far": "Pixels darker than those beside them, far",
}
AXES = {
    "range_m": "range in clear air, m",
    "margin_db": "margin over the detection threshold in clear air, dB",
    "azimuth_rad": "azimuth, degrees",
    "elevation_rad": "elevation, degrees",
    "cos_incidence": "cosine of incidence on the surface",
    "up": "upward part of the surface's normal",
    "log_intensity": "intensity in clear air, as the sensor gives it",
    "particle_range_m": "range of the particle, m",
    "isolated": "kind of target",
    "every_beam": "every beam alike",
    "all_targets": "of all targets",
    "target_class": "class of the target",
    "noise_floor_db": "noise floor over clear air's, dB",
    "ghost_delay_m": "distance behind the target, m",
    "depth_m": "depth, m",
    "depth_m_dark": "depth of dark surfaces, m",
    "depth_m_medium": "depth of medium surfaces, m",
    "depth_m_bright": "depth of bright surfaces, m",
    "depth_m_level": "depth of level ground, m",
    "depth_m_upright": "depth of upright surfaces, m",
    "modelled_signal": "modelled signal, of saturation",
    "departure_sd": "departure, standard deviations in clear air",
    "residual_sd": "departure from those beside it, standard deviations",
    "elevation_rad_near": "elevation, near by, degrees",
    "elevation_rad_far": "elevation, far, degrees",
    "off_axis_rad": "angle from the optical axis, degrees",
    "off_axis_rad_near": "angle from the optical axis, near by, degrees",
    "off_axis_rad_far": "angle from the optical axis, far, degrees",
    "column_share_near": "column, near by, of the width",
    "column_share_far": "column, far, of the width",
    "length_km": "length of the link, km",
    "frequency_ghz": "frequency, GHz",
    "minutes_since_rain": "time since rain, min",
    "frame": "from frame to frame",
    "time": "over time",
    "place": "in one place of every frame",
}
FORMULAS = {
    "constant": "a constant",
    "linear": "a straight line",
    "quadratic": "a parabola",
    "logarithm": "a logarithm",
    "power": "a power",
    "exponential_approach": "an exponential approach to a limit",
    "step": "a step",
    "sine": "a sine",
}
# GAP.md 2: what acts exactly like an effect, and what would tell them apart.
TWINS = {
    "lidar.window_loss": (
        "a laser that is weaker than in the clear frames",
        "clear frames recorded after those in weather, or the sensor's own record of its power",
    ),
    "lidar.extinction_scale": (
        "a rate or visibility that is farther off than its stated uncertainty, with as many particle returns as now",
        "a second record of the weather: a disdrometer, a visibility meter",
    ),
    "radar.path_loss_scale": (
        "a reference whose rain is off by a factor",
        "gauges under the links, or the relative standard deviation of the reference's rain (rain_rel_sd)",
    ),
}
# Without intensities only.
SILENT_TWINS = {
    "lidar.window_loss": "a higher detection threshold (lidar.threshold_shift)",
    "lidar.threshold_shift": "a loss at the window (lidar.window_loss)",
}
WHOLE = ("frame", "time", "place", "all_targets")  # axes with one bin
SURE, CERTAIN, NEARLY = 0.995, 0.999, 99.5  # of a confidence, of a posterior, of that in per cent
BEYOND = {"lowest": "lower", "highest": "higher"}
UNDETERMINED = "not determined by these data"  # an interval from one end of the search to the other
SAME = 1e-5  # relative: answers have six digits
UNIT_ENDING = re.compile(r"_(db|rad|m|px|min|m_per_s)$")  # of a parameter's name
TINY_P = 1e-6
LEAST_PER_CENT, ONE_DECIMAL = 0.05, 9.95  # of a percentage: below it none is shown; with one decimal
NO_END = 1e4  # an edge from it on is none
SKY_FROM_M = 1e4  # a depth beyond it is the sky's
LAGGED = re.compile(r"([a-z_]+)_(-?\d+)_(-?\d+)_px")  # of two pixels: down and to the right


def effect_name(name: str) -> str:
    """An effect's id in words.

    Example:
        >>> effect_name("lidar.window_loss")
        'window loss'
    """
    return name.partition(".")[2].replace("_", " ")


def statistic_name(name: str) -> str:
    """A statistic in words; one that this page does not know by its name.

    Example:
        >>> statistic_name("streak_correlation_16_-4_px")
        'Likeness of pixels apart by 16 down, −4 right'
    """
    lagged = LAGGED.fullmatch(name)
    if lagged:
        kind, down, right = lagged.groups()
        return f"{STATISTICS.get(kind, kind.replace('_', ' '))} {down} down, {right} right".replace("-", "−")
    return STATISTICS.get(name, name.replace("_", " "))


def axis_name(name: str) -> str:
    """An axis with its unit; one that this page does not know by its name."""
    return AXES.get(name, name.replace("_", " "))


def along(axis: str) -> str:
    """An axis without its unit, behind ``by``.

    Example:
        >>> along("range_m"), along("elevation_rad_near"), along("target_class")
        ('range', 'elevation, near by', 'class of the target')
    """
    name = axis_name(axis)
    return (name.rpartition(",")[0] or name).removesuffix(" in clear air")


def group_name(statistic: str, axis: str) -> str:
    """A statistic with its axis, for a row of a table.

    Example:
        >>> group_name("lost_share", "range_m"), group_name("particles", "place")
        ('Beams that lost their return, by range', 'Map of the particle returns, in one place of every frame')
    """
    if axis == "isolated":  # the statistic's name says so
        return statistic_name(statistic)
    word = "" if axis in WHOLE else "by "
    return f"{statistic_name(statistic)}, {word}{along(axis)}"


def curve_unit(unit: str) -> tuple[str, float]:
    """Unit in which a page shows a curve of an answer, and the factor to it.

    Example:
        >>> curve_unit("ln(intensity ratio)")[0], curve_unit("share of beams"), curve_unit("m")
        ('intensity ratio, dB', ('beams, %', 100.0), ('m', 1.0))
    """
    if unit == "ln(intensity ratio)":
        return "intensity ratio, dB", DB_PER_NEPER
    if unit == "standard deviation of ln(intensity)":
        return "standard deviation of the intensity, dB", DB_PER_NEPER
    if unit.startswith("share of "):
        return f"{unit.removeprefix('share of ')}, %", 100.0
    return unit, 1.0


def formula_words(name: str) -> str:
    """The shape of a formula in words."""
    return FORMULAS.get(name, name.replace("_", " "))


def exact_twins(name: str, *, with_intensity: bool) -> list[tuple[str, str]]:
    """Causes that are indistinguishable from an effect with such data, and the data that distinguish them.

    Args:
        name: of the effect.
        with_intensity: whether the sensor gives intensities.

    Example:
        >>> [twin for twin, _ in exact_twins("lidar.threshold_shift", with_intensity=False)]
        ['a loss at the window (lidar.window_loss)']
        >>> exact_twins("lidar.range_noise", with_intensity=False)
        []
    """
    found = [TWINS[name]] if name in TWINS else []
    if name in SILENT_TWINS and not with_intensity:
        found.append((SILENT_TWINS[name], "intensities, which the threshold leaves alone"))
    return found


def edge_text(axis: str, edge: float) -> str:
    """An edge of a bin in the units of ``axis_name``: angles in degrees, no logarithms, at most two decimals.

    Example:
        >>> edge_text("azimuth_rad", -math.pi), edge_text("log_intensity", 30.0), edge_text("margin_db", 1.5)
        ('−180', '∞', '1.5')
        >>> edge_text("particle_range_m", 60.0), edge_text("particle_range_m", 1e4)
        ('60', '∞')
        >>> edge_text("depth_m_bright", 42.0), edge_text("depth_m", 1e4), edge_text("depth_m", 1e6)
        ('42', 'sky', '')
    """
    if axis.startswith("depth_m") and edge >= SKY_FROM_M:
        return "sky" if edge == SKY_FROM_M else ""
    if axis.endswith(("_rad", "_rad_near", "_rad_far")):
        value = round(math.degrees(edge), 0 if axis == "azimuth_rad" else 1)
    else:
        value = round(math.exp(edge) if axis.startswith("log_") else edge, 2)
    return "∞" if value >= NO_END else f"{value + 0.0:g}".replace("-", "−")


def probability_text(p: float) -> str:
    """A p-value with two significant digits.

    Example:
        >>> [probability_text(p) for p in (0.4567, 0.00214, 3.9e-6, 1e-30)]
        ['0.46', '0.0021', '0.0000039', 'below 0.000001']
    """
    if p < TINY_P:
        return f"below {TINY_P:f}"
    return f"{float(f'{p:.2g}'):.7f}".rstrip("0")


def signed_decimal(value: float) -> str:
    """A number with one decimal and its sign, which 0 has not.

    Example:
        >>> signed_decimal(-3.14), signed_decimal(0.52), signed_decimal(-0.04)
        ('−3.1', '+0.5', '0.0')
    """
    text = f"{value:+.1f}"
    return "0.0" if float(text) == 0 else text.replace("-", "−")


def confidence_text(confidence: float) -> str:
    """A confidence with two decimals, never as certain.

    Example:
        >>> [confidence_text(value) for value in (0.5, 0.973, 1.0)]
        ['0.50', '0.97', 'over 0.99']
    """
    return "over 0.99" if confidence > SURE else f"{confidence:.2f}"


def posterior_text(weight: float) -> str:
    """A posterior in per cent, never as certain, nor as impossible.

    Example:
        >>> [posterior_text(value) for value in (1.0, 0.973, 0.0712, 0.0004)]
        ['over 99.9 %', '97 %', '7.1 %', 'below 0.1 %']
    """
    if weight > CERTAIN or weight < 1.0 - CERTAIN:
        return "over 99.9 %" if weight > CERTAIN else "below 0.1 %"
    return f"{100.0 * weight:.0f} %" if ONE_DECIMAL <= 100.0 * weight <= NEARLY else f"{100.0 * weight:.1f} %"


def parameter_rows(effect: Mapping[str, Any]) -> list[dict[str, str]]:
    """Parameters of a found effect with unit and interval; those that were not fitted and do nothing are left out.

    ``words`` is the parameter in plain words: ``azimuth −29.8°`` of an ``azimuth_rad``.

    Args:
        effect: of the answer's ``effects``.
    """
    interval = effect["interval"]
    declared = {one.name: one for one in EFFECTS[effect["name"]].arguments} if effect["name"] in EFFECTS else {}
    rows = []
    for name, value in effect["parameters"].items():
        one = declared.get(name)
        if name not in interval and one is not None and one.identity == float(value):
            continue
        unit = "" if one is None or one.unit == "1" else one.unit
        rows.append(
            {
                "name": name,
                "value": signed_text(value),
                "unit": unit,
                "interval": _interval_text(interval[name], one) if name in interval else "",
                "identity": "" if one is None or one.identity is None else signed_text(one.identity),
                "words": f"{parameter_name(name)} {_with_unit(value, unit)}",
            }
        )
    return rows


def parameter_name(name: str) -> str:
    """A parameter in words, without its unit.

    Example:
        >>> parameter_name("azimuth_rad"), parameter_name("db_per_ring"), parameter_name("loss_db")
        ('azimuth', 'db per ring', 'loss')
    """
    return UNIT_ENDING.sub("", name).replace("_", " ")


def _with_unit(value: float | str, unit: str) -> str:
    """A value with its unit; angles in degrees."""
    if unit == "rad":
        return f"{signed_text(math.degrees(float(value)))}°"
    return f"{signed_text(value)} {unit}".strip()


def _interval_text(interval: Sequence[float | str], declared: Parameter | None) -> str:
    """A central 90 % interval; one that reaches an end of what is searched is open there.

    Example:
        >>> loss = EFFECTS["lidar.window_loss"].arguments[0]
        >>> _interval_text([1.5, 2.5], loss), _interval_text([loss.low, 2.5], loss)
        ('1.50 to 2.50', '2.50 or less')
        >>> _interval_text([loss.low, loss.high], loss)
        'not determined by these data'
    """
    low, high = (float(end) for end in interval)
    if declared is None:
        return f"{signed_text(low)} to {signed_text(high)}"
    opens = [_same(low, declared.low), _same(high, declared.high)]
    if all(opens):
        return UNDETERMINED
    if opens[0]:
        return f"{signed_text(high)} or less"
    return f"{signed_text(low)} or more" if opens[1] else f"{signed_text(low)} to {signed_text(high)}"


def _same(value: float, bound: float) -> bool:
    """True for a bound as an answer holds it."""
    return value == bound or (math.isfinite(bound) and math.isclose(value, bound, rel_tol=SAME, abs_tol=1e-9))


def headline(answer: Mapping[str, Any]) -> str:
    """The verdict in a few words."""
    names = listed([effect_name(effect["name"]) for effect in answer["effects"]])
    return {
        "none": "Nothing found missing",
        "named": f"Missing: {names}",
        "named_and_rest": f"Missing: {names}, and more",
        "unknown": "Something unknown is missing",
    }[answer["verdict"]]


def gap_sentence(answer: Mapping[str, Any]) -> str:
    """The held-out departure before and after, what a perfect model scores, and the share of the excess left."""
    gap = answer["gap"]
    before, after, perfect = (number_text(gap[name]) for name in ("before", "after", "floor"))
    if answer["verdict"] == "none":
        return f"Held-out conditions depart by {before} standard deviations; a perfect model scores {perfect}."
    if answer["verdict"] == "unknown":
        closest = listed([effect_name(one["name"]) for one in answer.get("closest", [])])
        best = f"the best of the catalogue, {closest}" if closest else "the best effects"
        text = f"Held-out conditions depart by {before} standard deviations, and by {after} with {best}"
    else:
        text = f"Held-out conditions depart by {before} standard deviations before and {after} after"
    left = excess_text(gap)
    return f"{text}; a perfect model scores {perfect}" + (f", so {left} of the excess is left." if left else ".")


def excess_text(gap: Mapping[str, Any]) -> str:
    """Share of the held-out departure beyond a perfect model's that is left, in words; empty where there is none.

    Example:
        >>> [excess_text({"before": 3.0, "after": after, "floor": 1.0}) for after in (1.5, 1.1, 0.9)]
        ['25 %', '5.0 %', 'nothing']
        >>> excess_text({"before": 1.05, "after": 0.9, "floor": 1.0})
        ''
    """
    left = excess_left(float(gap["before"]), float(gap["after"]), float(gap["floor"]))
    if left is None:
        return ""
    per_cent = 100.0 * left
    if per_cent < LEAST_PER_CENT:
        return "less than 0.1 %" if per_cent > 0 else "nothing"
    return f"{per_cent:.1f} %" if per_cent < ONE_DECIMAL else f"{per_cent:.0f} %"


def verdict_sentence(answer: Mapping[str, Any]) -> str:
    """The verdict in plain words, with its numbers.

    Args:
        answer: in the format ``torchweather-gap/1``.

    Example:
        >>> gap = {"before": 2.13, "after": 1.02, "floor": 1.0, "interval_after": [0.9, 1.1], "split": "holdout"}
        >>> print(verdict_sentence({"verdict": "none", "effects": [], "gap": {**gap, "after": 2.13}, "p_value": 0.31}))
        Nothing is missing that these data could show (p = 0.31). Held-out conditions depart by 2.13 standard deviations; a perfect model scores 1.00.
        >>> loss = {"name": "lidar.window_loss", "parameters": {"loss_db": 0.02}, "interval": {"loss_db": [0.018, 0.022]},
        ...         "confidence": 0.97, "confusable_with": []}
        >>> print(verdict_sentence({"verdict": "named", "effects": [loss], "gap": gap, "p_value": 1e-9}))
        The simulation lacks window loss (lidar.window_loss): loss 0.0200 dB (90 %: 0.0180 to 0.0220), confidence 0.97. Held-out conditions depart by 2.13 standard deviations before and 1.02 after; a perfect model scores 1.00, so 1.8 % of the excess is left.
    """  # noqa: E501
    if answer["verdict"] == "none":
        chance = probability_text(answer["p_value"])
        return f"Nothing is missing that these data could show (p = {chance}). {gap_sentence(answer)}"
    if answer["verdict"] == "unknown":
        return f"Something is missing that no effect of the catalogue explains{_seen(answer)}. {gap_sentence(answer)}"
    found = "; and ".join(_lack(effect) for effect in answer["effects"])
    text = f"The simulation lacks {found}. {gap_sentence(answer)}"
    for effect in answer["effects"]:
        text += "".join(f" {bound_sentence(effect, *one)}" for one in effect.get("at_bound", {}).items())
    others = list(dict.fromkeys(name for effect in answer["effects"] for name in effect["confusable_with"]))
    if others:
        text += f" These data cannot exclude {listed([effect_name(name) for name in others], 'or')} in its place."
    if answer["verdict"] == "named_and_rest":
        text += f" More is missing, which no effect of the catalogue explains{_seen(answer)}."
    return text


def bound_sentence(effect: Mapping[str, Any], parameter: str, end: str) -> str:
    """Sentence on a value that stands at an end of those that are searched.

    Args:
        effect: of the answer's ``effects``.
        parameter: its name.
        end: ``lowest`` or ``highest``.

    Example:
        >>> brighter = {"name": "lidar.particle_backscatter", "parameters": {"gain_db": 10.0}}
        >>> bound_sentence(brighter, "gain_db", "highest")
        'The gain of particle backscatter is the highest value that is searched, 10.0 dB: the true one may be higher.'
    """
    declared = {one.name: one for one in EFFECTS[effect["name"]].arguments} if effect["name"] in EFFECTS else {}
    unit = "" if parameter not in declared or declared[parameter].unit == "1" else declared[parameter].unit
    return (
        f"The {parameter_name(parameter)} of {effect_name(effect['name'])} is the {end} value that is searched, "
        f"{_with_unit(effect['parameters'][parameter], unit)}: the true one may be {BEYOND[end]}."
    )


def _lack(effect: Mapping[str, Any]) -> str:
    rows = parameter_rows(effect)
    # What the data do not tell, or what does nothing, is in the table alone.
    told = [row for row in rows if row["interval"] != UNDETERMINED and row["value"] != row["identity"]] or rows
    parts = []
    for row in told:
        # Of several parameters the intervals would drown the rest; the table has them.
        alone = len(told) == 1 and row["interval"]
        between = row["interval"] if row["interval"] == UNDETERMINED else f"90 %: {row['interval']}"
        parts.append(f"{row['words']} ({between})" if alone else row["words"])
    sure = confidence_text(effect["confidence"])
    text = f"{effect_name(effect['name'])} ({effect['name']}): {', '.join(parts)}, confidence {sure}"
    if effect.get("beside_bound"):
        text += ", lowered: " + listed([effect_name(name) for name in effect["beside_bound"]])
        text += " beside it ends where the search does"
    return text


def _seen(answer: Mapping[str, Any]) -> str:
    """Statistic with most of the unexplained residual, in brackets; empty where it is not known."""
    rest = answer.get("unknown")
    if not rest:
        return ""
    name = group_name(rest["statistic"], rest["axis"])
    return f" (most of it in: {name[0].lower()}{name[1:]})"


def listed(names: Sequence[str], word: str = "and") -> str:
    """Names in a row: ``a, b and c``."""
    return f" {word} ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)
