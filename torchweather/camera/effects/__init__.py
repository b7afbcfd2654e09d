"""Effects that a camera may have; ``all`` registers them in the order of the catalogue."""
