"""Small calls of every public function with arrays, and these arrays; their shapes are written here once more."""

import jax
import jax.numpy as jnp
import numpy as np

import gsjax
from rasterizer import GSPLAT, Moments, Projection, TileGrid, TilePairs

N, C, H, W, D = 7, 2, 16, 24, 5
FLOATS = {(): "rate", (3,): "point", (N,): "opacities", (N, 3): "means scales", (N, 4): "quats", (N, 6): "triangles"}
FLOATS |= {(N, 3, 3): "covars", (C, 4, 4): "viewmats", (C, 3, 3): "Ks", (C, 4): "radial_coeffs", (N, D): "colors"}
FLOATS |= {(C, D): "backgrounds", (C, N, 2): "means2d extents slopes", (C, N): "depths compensations", (H, W): "depth"}
FLOATS |= {(C, N, 3): "conics", (C, N, 3, 3): "covars_c", (C, N, D): "features", (C, H, W, 1): "channel"}
FLOATS |= {(N, 9, D): "coeffs", (N, 1, D): "sh0", (N, 8, D): "shN", (N, 8): "weights", (H, W, 3): "image target"}
FLOATS |= {(C, H, W, 3): "channels"}
INTEGERS = {
    (): "count",
    (N,): "degrees",
    (9,): "splats",
    (13,): "offsets",
    (C, 2, 3): "isect_offsets",
    (C, H, W): "median",
}
TRUTHS = {(): "skipped", (N,): "seen", (H, W): "mask", (C, N): "visible", (C, 2, 3): "masks"}
SIZE, IMAGE_SIZE = {"width": W, "height": H}, {"image_width": W, "image_height": H, "tile_size": 8, "backend": "xla"}
TILES, LISTS, DENSE = {"tile_height": 2, "tile_width": 3}, {"backend": "xla", "capacity": 99}, {"backend": "reference"}
LENS, GRID = {"camera_model": "fisheye", "quats": None, "scales": None}, {"grid": TileGrid(C, W, H, 8)}
SPLATS = "means quats scales opacities viewmats Ks"
BLENDED = "means2d conics colors:features opacities:depths isect_offsets flatten_ids:splats"
CALLS = [  # Name, its arrays (argument, or argument:array), its other arguments.
    ("rasterization", f"{SPLATS} colors backgrounds masks means2d_probe:slopes absgrad:slopes", SIZE | LISTS),
    ("rasterization", "means opacities viewmats Ks covars radial_coeffs colors backgrounds:rate", SIZE | LENS | DENSE),
    ("project", SPLATS, SIZE | {"depth_mode": "plane", "rasterize_mode": "antialiased"}),
    ("project", "means opacities viewmats Ks covars radial_coeffs", SIZE | LENS),
    ("count_pairs", "projection", GRID),
    ("bin_splats", "projection opacities masks", GRID | LISTS | {"rules": GSPLAT}),
    ("blend", "projection opacities features pairs absgrad:slopes", GRID | {"backend": "xla", "with_median": True}),
    ("blend", "projection opacities:depths features pairs masks", GRID | {"backend": "xla"}),
    ("depth_channels", "projection", SIZE),
    ("depth_channels", "projection:flat", SIZE),
    ("blended_depth", "channels", {}),
    ("blended_depth", "channels:channel", {}),
    ("median_depth", "projection median", {}),
    ("spherical_harmonics", "dirs:means coeffs masks:seen", {"degrees_to_use": 2}),
    ("spherical_harmonics_l0", "sh0", {}),
    ("spherical_harmonics_l1_plus", "means viewmats shN masks:visible", {"degrees_to_use": 2}),
    ("upper_bands", "dirs:means coeffs:shN weights", {}),
    ("camera_normals", "means quats scales viewmats visible", {}),
    ("adam", "parameters:means gradients:scales moments skipped rate count", {}),
    ("all_finite", "tree:projection", {}),
    ("quat_scale_to_covar_preci", "quats scales", {"triu": True}),
    ("world_to_cam", "means covars viewmats", {}),
    ("proj", "means:conics covars:covars_c Ks", SIZE),
    ("fully_fused_projection", SPLATS, SIZE | {"covars": None, "calc_compensations": True}),
    ("fully_fused_projection", "means covars:triangles viewmats Ks opacities", SIZE | LENS),
    ("isect_tiles", "means2d radii:extents depths", TILES | {"tile_size": 8, "capacity": 99}),
    ("isect_offset_encode", "isect_ids", TILES | {"n_images": C}),
    ("rasterize_to_pixels", f"{BLENDED} backgrounds masks absgrad:slopes", IMAGE_SIZE),
    ("scales", "gaussians", {}),
    ("opacities", "gaussians", {}),
    ("pixel_rays", "camera", {}),
    ("psnr", "image target mask", {}),
    ("ssim", "image target mask", {}),
    ("depth_sdf", "point depth camera", {}),
    ("sdf_gradient", "gaussians camera", DENSE),
    ("render", "gaussians camera background:image extra:colors means2d_probe:probe", DENSE | {"with_depth": True}),
    ("render", "gaussians camera background:point active_degree:count", DENSE | {"with_axes": True}),
    ("render", "gaussians camera active_degree:degrees", DENSE),
    ("from_points", "points colors:bytes", {"capacity": 9}),
]


def make_arrays():
    """All that the calls name."""
    kinds = ((FLOATS, jnp.float32), (INTEGERS, jnp.int32), (TRUTHS, bool))
    rows = [(shape, names.split(), dtype) for shapes, dtype in kinds for shape, names in shapes.items()]
    arrays = {name: jnp.ones(shape, dtype) for shape, names, dtype in rows for name in names}
    projection = Projection(**{name: arrays[name] for name in Projection._fields})
    arrays |= {"projection": projection, "flat": projection._replace(slopes=None), "probe": projection.slopes[0]}
    arrays["pairs"] = TilePairs(arrays["splats"], arrays["offsets"], arrays["count"], arrays["skipped"])
    with jax.enable_x64(True):
        arrays["isect_ids"] = arrays["splats"].astype(jnp.int64)
    arrays |= {"moments": Moments(arrays["means"], arrays["means"]), "points": np.asarray(arrays["means"])}
    arrays["bytes"] = arrays["points"].astype(np.uint8)
    arrays["camera"] = gsjax.Camera(arrays["viewmats"][0], arrays["Ks"][0], W, H)
    return arrays | {"gaussians": gsjax.from_points(arrays["points"], arrays["points"], capacity=N)}
