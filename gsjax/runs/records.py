"""What the JSON files of a run folder must look like (`gsjax.io.json_shapes`), and the list of its views."""

from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.runs import splits

NUMBER = (None, float)
SETTINGS = {
    "photos?": {"downscale?": NUMBER, "images?": (None, str), "hold_out?": str, "masks?": {"valid", "matte"}},
    "supervision?": {"normal_axes?": (None, str)},
    "model?": {
        "background?": {"white", "black", "random"},
        "depth_mode?": {"plane", "front", "center"},
        "pixel_filter?": {"classic", "mip"},
    },
    "schedule?": {},
    "effects?": {"names?": str},
}
"""Of `config.json`: what later stages read; folders of earlier versions lack some."""
FIGURES = ("registered", "points", "psnr", "psnr_near_gains", "ssim", "gaussians", "vertices", "faces", "floaters",
           "seen_share")  # fmt: skip
"""What comes of a stage, in the order of a report."""
_STAGES = {str: {f"{name}?": NUMBER for name in ("seconds", "peak_gib", *FIGURES)}}
_EVIDENCE = {"on": bool, "evidence": NUMBER, "noise": NUMBER, "threshold": NUMBER, "unit": str, "note": str}
_VALIDATED = {"gain": float, "error": float}
_SPARSE_VIEWS = {"photos": int, "degrees": NUMBER, "gain": NUMBER, "error": NUMBER, "held_back": bool,
                 "depth?": NUMBER, "depth_error?": NUMBER, "dropout_alone?": bool}  # fmt: skip
MANIFEST = {
    **{f"{name}?": str for name in ("scene", "command", "created", "updated", "status", "photos", "normals")},
    "versions?": {str: str},
    "machine?": {str: (None, str, int)},
    "stages?": _STAGES,
    "effects?": {"simulated": [str], "evidence?": {str: _EVIDENCE}, "validated?": {str: _VALIDATED}},
    "sparse_views?": _SPARSE_VIEWS,
    "handed_in?": {"terms": [str], "effects": [str], "densification": bool},
    "split?": splits.SHAPE,
    **{f"{name}?": NUMBER for name in ("steps", "train_seconds", "peak_gib", *FIGURES)},
}
WHOLE_MANIFEST = {**MANIFEST, "scene": str, "command": str, "created": str, "status": str,
                  "versions": {str: str}, "machine": {"cpu": (None, str)}}  # fmt: skip
"""What a report takes for granted: that of every run that was begun."""
_PHASE = {"name": str, "steps": int}
PLAN = {"phases": [{**_PHASE, "terms": {str: float}, "needs": [str], "dropout?": float}], "steps": int,
        "downscale": float, "normals?": (None, str), "max_gaussians?": int}  # fmt: skip
SCENE = {"scene": str}
"""Of `manifest.json`: where the data set is."""
STATUS = {"status": str}
RECORD = {"step": int, "seconds?": float, "phase?": str}
"""A line of `metrics.jsonl`."""
VIEW = {"name": str, "width": int, "height": int, "viewmat": [[float, 4], 4], "K": [[float, 3], 3], "held_out": bool,
        "mask?": (None, str)}  # fmt: skip
MOST_SIDE, FARTHEST = 2**16, 1e15


def read_views(run: Path) -> list[dict[str, Any]]:
    """The records of `cameras.json`.

    Raises:
        InputError: The file is damaged or lists no views, or a camera in it is none; names the view.
    """
    file = run / "cameras.json"
    records = json_files.read(file, [VIEW])
    if not records:
        raise InputError(f"{file}: lists no views")
    for record in records:
        viewmat, K = np.array(record["viewmat"]), np.array(record["K"])
        turns = np.abs(viewmat).max() < FARTHEST and abs(np.linalg.det(viewmat[:3, :3]) - 1) < 0.1
        if not turns or viewmat[3].tolist() != [0, 0, 0, 1]:
            raise InputError(f"{file}: viewmat of {record['name']!r} is no world-to-camera matrix")
        if not (K[0, 0] > 0 and K[1, 1] > 0 and np.abs(K).max() < FARTHEST and K[2].tolist() == [0, 0, 1]):
            raise InputError(f"{file}: K of {record['name']!r} is no matrix of a camera in front")
        if not (0 < record["width"] <= MOST_SIDE and 0 < record["height"] <= MOST_SIDE):
            raise InputError(f"{file}: {record['name']!r} has {record['width']}x{record['height']} pixels")
    return records
