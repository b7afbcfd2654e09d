"""Studies with a hidden effect: scenes, weather and effects in code of their own, apart from the library's stages."""
