"""Effects of photography: their evidence in a scene, and their simulation in training. One module is one effect."""
