"""Rendered depth and meshes against the true depth and normals of a data set."""

from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np

from gsjax.gaussians import Gaussians
from gsjax.meshing.pictures import depth_of_mesh
from gsjax.meshing.ray_queries import ray_caster
from gsjax.metrics import geometry
from gsjax.normals.from_depth import depth_normals
from gsjax.rendering import DepthReading, gallery
from gsjax.runs.result import BACKGROUND_COLORS, frame_camera
from gsjax.scene import Frame, Truth
from gsjax.scene.meshes import Mesh

SKY, GROUND = 0, 255  # Labels of the truth; everything between is an object.
LENGTHS = frozenset({"chamfer", "accuracy", "completeness", "threshold", "depth_error", "mesh_depth_error"})
"""The scores that have units of the scene."""


def score_surface(
    gaussians: Gaussians, frames: tuple[Frame, ...], truth: Truth, depth_mode: DepthReading = "plane"
) -> dict[str, Any]:
    """Errors of the rendered depth and of its normals against true maps, pooled over the pixels of all frames.

    None is the error of a depth that has no pixel in common with the true one.
    """
    frames = _with_maps(frames, truth)
    if not frames:
        return {}
    cameras = [frame_camera(f) for f in frames]
    pictures = gallery.pictures(gaussians, cameras, BACKGROUND_COLORS["black"], depth_mode)
    return _score_depths((picture.depth for picture in pictures), frames, truth)


def score_mesh_views(mesh: Mesh, frames: tuple[Frame, ...], truth: Truth) -> dict[str, Any]:
    """The same of the depth at which rays meet a mesh, names with "mesh_" before them."""
    cast, frames = ray_caster(mesh), _with_maps(frames, truth)
    depths = (depth_of_mesh(cast, frame_camera(f)) for f in frames)
    return {f"mesh_{name}": value for name, value in _score_depths(depths, frames, truth).items()}


def _with_maps(frames: tuple[Frame, ...], truth: Truth) -> tuple[Frame, ...]:
    return tuple(f for f in frames if f.name in truth.normals or f.name in truth.depths)


def _score_depths(depths: Iterable[np.ndarray], frames: tuple[Frame, ...], truth: Truth) -> dict[str, Any]:
    """Errors of depth maps `[H, W]`, one a frame, and of their normals against true maps, where there are any."""
    normals, true, objects, depth_errors = [], [], [], []
    for frame, depth in zip(frames, depths, strict=True):
        is_object = np.ones(depth.shape, bool)
        if frame.name in truth.labels:
            labels = truth.labels[frame.name]()
            is_object = (labels != SKY) & (labels != GROUND)
        if frame.name in truth.normals:
            normals.append(np.asarray(depth_normals(jnp.asarray(depth), frame_camera(frame))).reshape(-1, 3))
            true.append(truth.normals[frame.name]().reshape(-1, 3))
            objects.append(is_object.reshape(-1))
        if frame.name in truth.depths:
            true_depth = truth.depths[frame.name]()
            both = is_object & (true_depth > 0) & (depth > 0)
            depth_errors.append(np.abs(true_depth - depth)[both])
    figures: dict[str, Any] = {}
    if normals:
        maps, true_normals, mask = np.concatenate(normals), np.concatenate(true), np.concatenate(objects)
        on_objects = geometry.normal_error_degrees(maps, true_normals, mask)
        anywhere = geometry.normal_error_degrees(maps, true_normals, np.ones_like(mask))
        figures |= {
            "normal_error_deg": on_objects["mean"],
            "normal_error_median_deg": on_objects["median"],
            "normal_error_all_deg": anywhere["mean"],
        }
    if depth_errors:
        errors = np.concatenate(depth_errors)
        figures["depth_error"] = float(errors.mean()) if len(errors) else None
    return figures
