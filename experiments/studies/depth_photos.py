"""What depth is in the surface phase of real photos: the mean of the splats' planes, or of those in front.

Small photos and few Gaussians, as in `surface_photos.py`.
"""

from studies.surface_photos import CONFIG as SURFACE

_VARIANTS = SURFACE["variants"]
CONFIG: dict = {
    "base": SURFACE["base"],
    "variants": {
        "vanilla": _VARIANTS["vanilla"],
        **{mode: {**_VARIANTS["all of them"], "depth_mode": mode} for mode in ("plane", "front")},
    },
}
