"""Validation of D3.4 (Figure 18): measured against clear beside simulated against clear, score by score."""

from torchweather.evaluation.validation.run import Validation, validate

__all__ = ["Validation", "validate"]
