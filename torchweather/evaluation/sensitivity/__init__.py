"""Sensitivity of what is simulated to defaults that no measurement fixes."""

from torchweather.evaluation.sensitivity.change import Change, changes
from torchweather.evaluation.sensitivity.ranges import Moved, printed_uncertainty, results, sensitivity, uncertainty

__all__ = ["Change", "Moved", "changes", "printed_uncertainty", "results", "sensitivity", "uncertainty"]
