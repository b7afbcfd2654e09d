"""Scores of images and point clouds against a reference."""

from __future__ import annotations
