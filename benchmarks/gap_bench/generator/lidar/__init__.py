"""LiDAR studies with a hidden effect: rays, particles and effects in code of their own."""
