"""What does the gate before normals bring on real photos, to a network's maps and to the run's own?

    gsjax normals PHOTOS --network RECORD.json --weights NETWORK.onnx --out PHOTOS/normals_network
    python experiments/compare.py gate --scene PHOTOS --out DIR

Beside training without R. R at the means acts in every step, with a weight of the paper's range.
"""

from collections.abc import Mapping
from typing import Any

ON = "photos_short"
NETWORK = "{scene}/normals_network"


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """No R; own normals and a network's, gated and not."""
    *plain, surface = config["phases"]

    def taught(**differences: Any) -> dict[str, Any]:
        return {"phases": [*plain, {**surface, "weights": {"sdf_normal": 0.2}, "surface_every": 1}], **differences}

    return {
        "without R": {"phases": [*plain, {**surface, "weights": {}}]},
        "own, gated": taught(normal_gate=True),
        "own, not gated": taught(normal_gate=False),
        "network, gated": taught(normals=NETWORK, normal_gate=True),
        "network, not gated": taught(normals=NETWORK, normal_gate=False),
    }
