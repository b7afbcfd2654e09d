"""Scores over a sweep of weather, validation against recordings, and the robustness of detectors."""
