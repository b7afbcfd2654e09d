"""Physically right rain, fog and snow on automotive camera, LiDAR and radar data."""

from __future__ import annotations

__version__ = "0.1.0"
