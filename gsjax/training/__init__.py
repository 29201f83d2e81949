"""Gaussians from photos: the compiled step, the loop over the phases, losses, optimisers, densification."""
