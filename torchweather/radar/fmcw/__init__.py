"""An FMCW radar from scatterers to points."""
