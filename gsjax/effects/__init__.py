"""Effects of photography: how a scene tells that it needs one, and how training takes it in."""
