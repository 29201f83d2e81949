"""Fifty real photos of an indoor scene, 267x475 (the undistorted COLMAP model)."""

CONFIG: dict = {}
