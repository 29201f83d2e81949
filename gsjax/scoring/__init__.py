"""Scores of Gaussians and meshes over the views of a data set: images against photos, surfaces against truth."""
