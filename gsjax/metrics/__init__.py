"""How good a result is: images and geometry."""
