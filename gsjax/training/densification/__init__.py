"""Densification: which Gaussians split, are cloned and pruned, by the rules of `densification.rules`."""
