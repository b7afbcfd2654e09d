"""Inference of missing effects from statistics: likelihood by simulation, response templates, forward selection."""
