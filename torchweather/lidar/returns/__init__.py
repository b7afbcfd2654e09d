"""Returns of drops, flakes and fog in a beam."""
