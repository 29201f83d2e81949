"""A run on one page: facts from its folder, curves, pictures."""
