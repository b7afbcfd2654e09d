"""Sweeps as they are recorded: rings, beams without return and where they end, frames, sensors fitted to them."""
