"""Data sets on disk: whole folders in weather."""
