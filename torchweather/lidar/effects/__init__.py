"""Effects that a lidar may have."""
