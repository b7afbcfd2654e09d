"""Weather: rain, fog and snow, their density over space and time, and the optics of fog."""
