"""A built-in scene of our own, known exactly."""
