"""Hidden effects in camera studies: a generator that shares no code with the model under test beyond its physics."""
