"""What a detector makes of the weather: an ONNX detector over weather and severity, held against ground truth."""

from torchweather.robustness.declaration import FORMAT, Declaration, read_declaration
from torchweather.robustness.detector import OnnxDetector
from torchweather.robustness.performance import Performance
from torchweather.robustness.rates import Rates, rates
from torchweather.robustness.run import (
    ConditionResult,
    LabelledFrame,
    RobustnessResult,
    conditions_of,
    run_robustness,
)
from torchweather.robustness.truth import BoxTruth, LabelTruth, read_boxes_truth, read_label_truth

__all__ = [
    "FORMAT",
    "BoxTruth",
    "ConditionResult",
    "Declaration",
    "LabelTruth",
    "LabelledFrame",
    "OnnxDetector",
    "Performance",
    "Rates",
    "RobustnessResult",
    "conditions_of",
    "rates",
    "read_boxes_truth",
    "read_declaration",
    "read_label_truth",
    "run_robustness",
]
