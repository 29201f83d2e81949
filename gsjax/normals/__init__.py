"""Normals: the SDF estimate and its gradient, maps from depth, foreign maps and their axes."""
