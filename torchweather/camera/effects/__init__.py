"""Effects that a camera may have."""
