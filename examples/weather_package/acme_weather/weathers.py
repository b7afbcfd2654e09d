"""Drizzle: a function that builds one of the library's weathers from the fields that users may give."""

from torchweather import Fog, Mixture, Rain


def drizzle(rate_mm_per_h=0.3, mor_m=2000.0):
    """Light rain of many small drops, in haze."""
    return Mixture(Rain(rate_mm_per_h, size_distribution="drizzle"), Fog(mor_m=mor_m))
