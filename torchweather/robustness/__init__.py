"""Robustness of an ONNX detector: its performance over weather and severity, compared with ground truth."""

from torchweather.robustness.declaration import FORMAT, Declaration, read_declaration
from torchweather.robustness.detector import OnnxDetector
from torchweather.robustness.draft import draft_declaration
from torchweather.robustness.frames import LabelledFrame
from torchweather.robustness.intervals import Interval
from torchweather.robustness.operating import OperatingPoint
from torchweather.robustness.performance import Performance
from torchweather.robustness.rates import Rates, rates
from torchweather.robustness.result import ConditionResult, RobustnessResult
from torchweather.robustness.run import conditions_of, run_robustness
from torchweather.robustness.truth import BoxTruth, LabelTruth, read_boxes_truth, read_label_truth

__all__ = [
    "FORMAT",
    "BoxTruth",
    "ConditionResult",
    "Declaration",
    "Interval",
    "LabelTruth",
    "LabelledFrame",
    "OnnxDetector",
    "OperatingPoint",
    "Performance",
    "Rates",
    "RobustnessResult",
    "conditions_of",
    "draft_declaration",
    "rates",
    "read_boxes_truth",
    "read_declaration",
    "read_label_truth",
    "run_robustness",
]
