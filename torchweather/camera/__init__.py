"""The camera: depth of its pictures (more rooms follow)."""
