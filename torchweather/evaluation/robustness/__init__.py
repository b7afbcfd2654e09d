"""Robustness of an ONNX detector: its performance over weather and severity, compared with ground truth."""

from torchweather.evaluation.robustness.declaration import FORMAT, Declaration, read_declaration
from torchweather.evaluation.robustness.detector import OnnxDetector
from torchweather.evaluation.robustness.draft import draft_declaration
from torchweather.evaluation.robustness.frames import LabelledFrame
from torchweather.evaluation.robustness.intervals import Interval
from torchweather.evaluation.robustness.operating import OperatingPoint
from torchweather.evaluation.robustness.performance import Performance
from torchweather.evaluation.robustness.rates import Rates, rates
from torchweather.evaluation.robustness.result import ConditionResult, RobustnessResult
from torchweather.evaluation.robustness.run import conditions_of, run_robustness
from torchweather.evaluation.robustness.truth import BoxTruth, LabelTruth, read_boxes_truth, read_label_truth

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
