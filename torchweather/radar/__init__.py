"""FMCW radar: scatterers to beat signal to range-Doppler-angle maps to points."""

from __future__ import annotations
