"""Radar frames: simulation, and statistics of targets, empty cells and further detections."""
