"""The catalogue of hard cases: one odd Gaussian among 39 ordinary ones, an odd camera, or odd piles of Gaussians.

All cases of one odd Gaussian share one shape, so that each backend compiles once.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from hard_cases_page import FAMILIES
from scenes import GAUSSIAN_FIELDS, Scene, cloud, single, stacks, with_odd_one

NAN, INF = float("nan"), float("inf")
ORDINARY = {
    "means": (0.1, -0.1, 2.0),
    "quats": (0.8, 0.2, -0.5, 0.3),
    "scales": (0.2, 0.1, 0.15),
    "opacities": 0.7,
    "colors": (0.9, 0.5, 0.1),
}

# Family -> name -> fields of the odd Gaussian. It must not show, nor disturb anything.
HIDDEN_BY_FAMILY = {
    "zero, denormal and huge scales": {"scale outside float32 when squared": {"scales": (1e25, 0.1, 0.1)}},
    "opacity 1 and 0": {
        "opacity 0": {"opacities": 0.0},
        "opacity under the cut": {"opacities": 0.0039},
        "opacity denormal": {"opacities": 1e-40},
    },
    "at the near plane, behind, far, outside the image": {
        "behind": {"means": (0.1, 0.1, -2.0)},
        "at the eye": {"means": (0.0, 0.0, 0.0)},
        "on the camera plane, beside": {"means": (3.0, -1.0, 0.0)},
        "just behind the plane": {"means": (0.0, 0.0, -1e-7)},
        "between eye and near plane": {"means": (0.0, 0.0, 0.005)},
        "beyond the far plane": {"means": (0.0, 0.0, 1e11), "scales": (1e10,) * 3},
        "far beside, grazing": {"means": (1e6, 1e6, 0.02)},
        "outside float32 when squared": {"means": (1e25, -1e25, 1.0)},
        "outside float32 when projected": {"means": (3e38, 3e38, 0.011)},
    },
    "non-finite input: NaN or infinite fields": {
        **{
            f"{field} {bad}": {field: (bad, *ORDINARY[field][1:]) if field != "opacities" else bad}
            for field in GAUSSIAN_FIELDS
            for bad in (NAN, INF, -INF)
            if (field, bad) != ("opacities", INF)
        },
        "all NaN": {field: np.full_like(ORDINARY[field], NAN) for field in GAUSSIAN_FIELDS},
    },
}
HIDDEN = {name: fields for cases in HIDDEN_BY_FAMILY.values() for name, fields in cases.items()}

# name -> fields of the odd Gaussian. It must show as in float64.
VISIBLE = {
    "ordinary": {},
    "zero quaternion": {"quats": (0.0, 0, 0, 0)},
    "denormal quaternion": {"quats": (1e-40, 1e-41, 0, 0)},
    "short quaternion": {"quats": (8e-10, 2e-10, -5e-10, 3e-10)},
    "long quaternion": {"quats": (8e19, 2e19, -5e19, 3e19)},
    "one flat axis": {"scales": (0.2, 0.0, 0.15)},
    "two flat axes": {"scales": (0.2, 0.0, 0.0)},
    "a point": {"scales": (0.0, 0.0, 0.0)},
    "denormal scales": {"scales": (1e-40, 1e-42, 1e-39)},
    "needle 1e6": {"scales": (1.0, 1e-6, 1e-6)},
    "needle 1e-6": {"scales": (1e-6, 1.0, 1.0)},
    "huge": {"scales": (1e3, 1e3, 1e3)},
    "as large as float32 allows": {"scales": (1e8, 1e8, 1e8)},
    "long needle 1e6": {"scales": (1e5, 0.1, 0.1)},
    "long needle 1e6, along x": {"scales": (1e5, 0.1, 0.1), "quats": (1.0, 0, 0, 0)},
    "opacity 1": {"opacities": 1.0},
    "denormal mean": {"means": (1e-40, -1e-42, 2.0)},
    "just past the near plane": {"means": (0.001, 0.001, 0.0101), "scales": (1e-4, 1e-4, 1e-4)},
    "far away": {"means": (0.0, 0.0, 1e6), "scales": (1e5, 1e5, 1e5)},
    "coincident with another": {"means": None},
    "huge colour": {"colors": (1e6, -1e6, 0.0)},
    "disc edge-on": {"means": (0.0, 0.0, 2.0), "quats": (1.0, 0, 1.0, 0), "scales": (0.2, 0.2, 1e-6)},
    "needle along the ray": {"means": (0.0, 0.0, 2.0), "quats": (1.0, 0, 0, 0), "scales": (1e-6, 1e-6, 1.0)},
    "needle past the eye": {"quats": (0.95, 0.2, -0.2, 0.1), "scales": (0.1, 0.1, 1e3)},
    "ground at a grazing angle": {"means": (0.0, 0.3, 1.0), "quats": (1.0, 0, 0, 0), "scales": (3.0, 1e-3, 3.0)},
    "at the image border": {"means": (1.2, -0.1, 2.0)},
    "mean far outside the image": {"means": (60.0, -20.0, 2.0), "scales": (40.0, 0.3, 30.0)},
}
# Other camera models. Blending knows of none: one engine shows it, the others by night.
OTHER_MODELS = {
    "fisheye": {"camera_model": "fisheye", "radial_coeffs": np.array([[0.05, -0.02, 0.01, -0.003]])},
    "ortho": {"camera_model": "ortho"},
}
VISIBLE_BY_OTHER_MODELS = {
    **{
        name: VISIBLE[name]
        for name in (
            "ordinary", "a point", "needle 1e6", "huge", "denormal mean", "just past the near plane",
            "needle along the ray", "needle past the eye", "at the image border", "mean far outside the image",
        )
    },
    "on the axis": {"means": (0.0, 0.0, 2.0)},
    "next to the camera": {"means": (0.5, 0.1, 0.02), "scales": (0.3, 0.3, 0.3)},
}  # fmt: skip
ANTIALIASED = "ordinary", "a point", "two flat axes", "needle 1e6", "huge", "far away"
"""Cases of `VISIBLE` that are rendered antialiased too, of an opacity of 0.9."""


def odd(fields):
    scene = cloud()
    fields = {**ORDINARY, **fields}
    if fields["means"] is None:
        fields["means"] = scene.means[7]
    return with_odd_one(scene, **fields)


def antialiased(name):
    """A scene of `ANTIALIASED`."""
    return odd({**VISIBLE[name], "opacities": 0.9})


def focal_length(focal):
    """Ordinary Gaussians under an odd focal length, pixels."""
    scene = cloud()
    K = scene.Ks.at[0, 0, 0].set(focal).at[0, 1, 1].set(1.5 * focal)
    if focal > 1:
        # On the axis, or nothing is left in the image.
        scene = replace(scene, means=scene.means.at[:, :2].multiply(1e-6))
    return replace(scene, Ks=K)


def coincident_depths():
    """Ordinary Gaussians, all of one depth."""
    scene = cloud()
    return replace(scene, means=scene.means.at[:, 2].set(2.5))


def forty_copies():
    """One faint Gaussian forty times."""
    copies = odd({"opacities": 0.03})
    return replace(copies, **{f: jnp.repeat(getattr(copies, f)[-1:], 40, 0) for f in GAUSSIAN_FIELDS})


def one_pixel():
    """An image of one pixel."""
    return cloud(20, size=(1, 1), channels=1)


def pile(opacity):
    """3,000 Gaussians of one opacity, nearly all on one pixel."""
    count, rng = 3000, np.random.default_rng(0)
    scene = single(size=5, scale=(0.1, 0.2, 0.05), quat=(0.9, 0.3, -0.4, 0.2))
    scene = replace(scene, **{f: jnp.repeat(getattr(scene, f), count, 0) for f in GAUSSIAN_FIELDS})
    return replace(
        scene,
        means=scene.means + jnp.asarray(rng.normal(size=(count, 3)) * [1e-3, 1e-3, 1e-2], jnp.float32),
        colors=jnp.asarray(rng.uniform(size=(count, 2)), jnp.float32),
        opacities=jnp.full(count, opacity, jnp.float32),
    )


FOCAL_LENGTHS = 1e-2, 1e6
PILES = 0.005, 0.9


class Case(NamedTuple):
    """A scene, the scene whose image in float64 is the correct one, and options of `rasterization`."""

    scene: Scene
    expected: Scene  # the same, or without a Gaussian that must not show
    options: dict[str, Any]


def images_by_family():
    """Family -> name -> `Case`, of all that renders colours.

    The families are those of `FAMILIES`, with cameras and antialiasing apart. Fisheye cameras have no coefficients.
    """
    scenes = {
        **{name: odd(fields) for name, fields in VISIBLE.items()},
        "nothing odd": cloud(),
        "pixels that stop early": stacks(),
        "all depths coincide": coincident_depths(),
        "forty copies of one": forty_copies(),
        **{f"3000 on one pixel, opacity {opacity}": pile(opacity) for opacity in PILES},
    }
    without = odd({"opacities": 0.0})
    families = {
        family: {name: Case(scenes[name], scenes[name], {}) for name in names if name in scenes}
        | {name: Case(odd(fields), without, {}) for name, fields in HIDDEN_BY_FAMILY.get(family, {}).items()}
        for family, names in FAMILIES.items()
        if not family.startswith("cameras")
    }
    others = {f"focal length {focal:g} px": focal_length(focal) for focal in FOCAL_LENGTHS} | {"one pixel": one_pixel()}
    groups = {"cameras: focal lengths of 0.01 and 1e6 px, one pixel": (others, {})}
    for model in OTHER_MODELS:
        visible = {name: odd(fields) for name, fields in VISIBLE_BY_OTHER_MODELS.items()}
        groups[f"cameras: {model}"] = visible, {"camera_model": model}
    groups["antialiased"] = {name: antialiased(name) for name in ANTIALIASED}, {"rasterize_mode": "antialiased"}
    return families | {
        family: {name: Case(scene, scene, options) for name, scene in group.items()}
        for family, (group, options) in groups.items()
    }
