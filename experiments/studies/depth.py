"""What depth is in the surface phase and in the scores: that of centres, of planes, or of the planes in front.

With true normals, and with what serves real photos: normals of one's own depth, and photos that agree with each other.
"""

from gsjax.settings import DEMO, FAST

_VANILLA, _SURFACE = DEMO["phases"]
_AS_PHOTOS = {"phases": [_VANILLA, {**_SURFACE, "weights": FAST["phases"][-1]["weights"]}]}
CONFIG: dict = {
    "base": "demo",
    "variants": {
        "centre": {"normals": "{scene}/normals", "depth_mode": "center"},
        "plane": {"normals": "{scene}/normals", "depth_mode": "plane"},
        "front": {"normals": "{scene}/normals", "depth_mode": "front"},
        "plane, without normals": {**_AS_PHOTOS, "depth_mode": "plane"},
        "front, without normals": {**_AS_PHOTOS, "depth_mode": "front"},
    },
}
