"""Camera frames: simulation, and statistics of brightness, sharpness, texture and tails."""
