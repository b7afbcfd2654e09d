"""Microwave links: records sorted by rain, and the statistics of their attenuation."""
