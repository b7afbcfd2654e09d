"""Effects that a radar may have; ``all`` registers them in the order of the catalogue."""
