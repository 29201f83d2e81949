"""Gaussians bound to a mesh: trained together with its vertices, and taken along when it is edited."""
