"""Sensors of the gap search: how frames of a kind are simulated and reduced to statistics."""
