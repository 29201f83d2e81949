"""gsplat's arguments that nothing here answers to: taken where they ask for nothing, else refused by name."""

from typing import Any

# What each is in gsplat where it asks for nothing (1.6; of the arguments of `rasterization` and of the stages).
_NOTHING = {
    "sparse_grad": False,
    "distributed": False,
    "segmented": False,
    "with_ut": False,
    "with_eval3d": False,
    "global_z_order": True,
    "rays": None,
    "tangential_coeffs": None,
    "thin_prism_coeffs": None,
    "ftheta_coeffs": None,
    "lidar_coeffs": None,
    "external_distortion_coeffs": None,
    "rolling_shutter": "GLOBAL",
    "viewmats_rs": None,
    "ut_params": None,
    "extra_signals": None,
    "extra_signals_sh_degree": None,
    "renderer_config": None,
}
_REASONS = {
    "sparse_grad": "jax's gradients are dense",
    "distributed": "a call renders on one device",
    "segmented": "there is one sort",
    "global_z_order": "splats are sorted by camera z",
    "tangential_coeffs": "undistort the photos",
    "thin_prism_coeffs": "undistort the photos",
    "extra_signals": "pass further channels of `colors`",
}
# Memory layout and speed of gsplat's kernels: the image is the same, whatever they say.
_WITHOUT_EFFECT = {"packed", "channel_chunk"}


def refuse(**options: Any) -> None:
    """Raise ValueError for an option of gsplat that asks for something."""
    for name, value in options.items():
        if not _is(value, _NOTHING[name]):
            shown = f"{name}={value!r}" if isinstance(value, bool | int | float | str) else name
            raise ValueError(f"{shown} is not supported" + (f": {_REASONS[name]}" if name in _REASONS else ""))


def refuse_at_the_door(options: dict[str, Any]) -> None:
    """Raise for what `rasterization` was given besides its own arguments.

    Raises:
        ValueError: gsplat has the argument, and it asks for something.
        TypeError: gsplat has no such argument either.
    """
    for name in sorted(options.keys() - _NOTHING.keys() - _WITHOUT_EFFECT):
        raise TypeError(f"rasterization() got an unexpected keyword argument {name!r}")
    refuse(**{name: value for name, value in options.items() if name not in _WITHOUT_EFFECT})


def _is(value: Any, nothing: Any) -> bool:
    """Whether the value is that one; of an enum (gsplat's rolling shutter) by its name. Arrays never are."""
    value = getattr(value, "name", value)
    return value is nothing or (isinstance(value, bool | int | float | str) and value == nothing)
