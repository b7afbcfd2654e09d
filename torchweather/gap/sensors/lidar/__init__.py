"""LiDAR sweeps: simulation, and statistics of what became of each beam."""
