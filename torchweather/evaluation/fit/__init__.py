"""Rate or visibility from recordings, by several estimators side by side, with intervals and a residual check."""

from torchweather.evaluation.fit.result import ConditionFit, Estimate, Value, WeatherFit
from torchweather.evaluation.fit.run import fit_weather

__all__ = ["ConditionFit", "Estimate", "Value", "WeatherFit", "fit_weather"]
