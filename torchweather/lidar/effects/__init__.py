"""Effects that a LiDAR may have; ``all`` registers them in the order of the catalogue."""
