"""Drops and flakes in front of a camera."""
