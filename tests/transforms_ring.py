"""A data set of a transforms.json whose cameras surround the origin."""

import json

import cv2
import numpy as np


def looking_at(center, target=(0.0, 0.0, 0.0)):
    """Camera to world, OpenGL axes, z of the world up."""
    back = np.subtract(center, target) / np.linalg.norm(np.subtract(center, target))
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, center], axis=1)
    return matrix


def ring(count=8, radius=2.0, target=(0.0, 0.0, 0.0)):
    angles = 2 * np.pi * np.arange(count) / count
    return [looking_at(np.array([radius * np.cos(a), radius * np.sin(a), 0.5]) + target, target) for a in angles]


def red_behind_glass():
    """BGRA; clear in the upper half."""
    pixels = np.full((30, 40, 4), (0, 0, 255, 128), np.uint8)
    pixels[:15, :, 3] = 255
    return pixels


def write(root, file="transforms.json", folder="images", poses=None, suffix=".png", **meta):
    (root / folder).mkdir(parents=True, exist_ok=True)
    frames = []
    for i, pose in enumerate(ring() if poses is None else poses):
        path = f"{folder}/{i:03d}"
        cv2.imwrite(str(root / f"{path}.png"), red_behind_glass())
        frames.append({"file_path": "./" + path + suffix, "transform_matrix": np.asarray(pose).tolist()})
    (root / file).write_text(json.dumps({**meta, "frames": frames}))
    return root


def edit(root, change, file="transforms.json"):
    meta = json.loads((root / file).read_text())
    change(meta)
    (root / file).write_text(json.dumps(meta))
