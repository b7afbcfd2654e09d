"""Scores over a sweep of weather, and the robustness of detectors."""
