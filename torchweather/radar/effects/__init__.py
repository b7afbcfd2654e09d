"""Effects that a radar may have."""
