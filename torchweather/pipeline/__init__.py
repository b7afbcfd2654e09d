"""Stages, effects and chains, and the transform that the sensors share."""
