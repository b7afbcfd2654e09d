"""The camera: sensor, transform, fog, particles, effects, depth of its pictures."""
