"""Radar studies with a hidden effect: targets, weather and effects in code of their own, apart from the library's."""
