"""A house on a lawn under a sky with soft clouds, known exactly: its photos, and how far a mesh is from it.

Walls are plain white but for their windows, as facades are, and no track lies on what is plain.
"""

from pathlib import Path
from typing import Any

import numpy as np

from gsjax.cameras import Camera, landing, look_at, viewmat_center
from gsjax.io.colmap_writer import write_whole
from gsjax.io.files import make_folder
from gsjax.io.images import write_image
from gsjax.io.packages import require
from gsjax.measures.geometry import sample_surface
from gsjax.meshes import Mesh
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.meshing.rays import Cast, ray_caster

PHOTOS, SIZE, FOCAL = 14, (200, 152), 150.0  # width and height, pixels
SAMPLES = 3  # rays along each side of a pixel
LAWN = 40.0  # metres from the middle to its edge
POINTS, TRACK_NOISE = 6000, 0.3  # drawn, of which those on a plain wall are dropped; pixels
OFF = 0.3  # metres: a surface that far from the truth is none
AROUND = 8.0  # metres about the house in which a mesh is judged
_SUN = np.array([0.5, -0.6, 0.62])
_WALL, _ROOF, _LAWN, _TRUNK, _CROWN = range(5)


def house() -> tuple[Mesh, np.ndarray]:
    """The surface, metres and z up, and what every triangle is made of."""
    vertices, faces, kinds = [], [], []

    def add(corners: list, quads: list, kind: int) -> None:
        start = len(vertices)
        vertices.extend(corners)
        for quad in quads:
            for triangle in ((0, 1, 2), (0, 2, 3))[: len(quad) - 2]:
                faces.append([start + quad[corner] for corner in triangle])
                kinds.append(kind)

    def box(low: tuple, high: tuple, kind: int) -> None:
        corners = [(x, y, z) for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
        add(corners, [[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [4, 5, 7, 6]], kind)

    def gable(low: tuple, high: tuple, ridge: float) -> None:
        (x0, y0, z), (x1, y1, _), y = low, high, (low[1] + high[1]) / 2
        corners = [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z), (x0, y, ridge), (x1, y, ridge)]
        add(corners, [[0, 1, 5, 4], [2, 3, 4, 5]], _ROOF)
        add(corners, [[1, 2, 5], [3, 0, 4]], _WALL)

    box((-3, -2, 0), (3, 2, 3), _WALL)
    gable((-3.2, -2.3, 3), (3.2, 2.3, 3), 5.0)
    box((1.2, -0.4, 4), (1.8, 0.2, 5.6), _ROOF)
    box((-5.6, -1.5, 0), (-3, 1.5, 2.2), _WALL)
    gable((-5.8, -1.7, 2.2), (-3, 1.7, 2.2), 3.2)
    box((4.4, 0.2, 0), (4.7, 0.5, 2.2), _TRUNK)
    box((3.7, -0.5, 2.0), (5.4, 1.2, 3.8), _CROWN)
    add([(-LAWN, -LAWN, 0), (LAWN, -LAWN, 0), (LAWN, LAWN, 0), (-LAWN, LAWN, 0)], [[0, 1, 2, 3]], _LAWN)
    mesh = Mesh(np.array(vertices, np.float32), np.array(faces, np.int32), np.full((len(vertices), 3), 128, np.uint8))
    return mesh, np.array(kinds)


def surface_colors(points: np.ndarray, normals: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """`[R, 3]` display-coded colours of points of the surface, 0..1."""
    x, y, z = points.T
    grain = np.sin(7 * x + 3 * y) * np.sin(5 * y - 4 * z + 1) + 0.6 * np.sin(17 * x - 11 * z) * np.sin(15 * y + 13 * z)
    fine = np.sin(31 * x + 5) * np.sin(29 * y + 27 * z)
    window = (np.mod(x + y + 0.4, 1.5) < 0.7) & (np.mod(z, 1.5) > 0.6) & (np.mod(z, 1.5) < 1.35)
    tiles = np.sin(14 * x) * np.sign(np.sin(18 * z)) * 0.5 + 0.5 * grain
    leaves = 0.7 * np.sin(19 * x + 4 * z) * np.sin(23 * y - 6 * z) + 0.7 * np.sin(37 * z + 9 * x) * np.sin(33 * y)
    albedo = np.empty((len(points), 3))
    for kind, low, high, pattern in (
        (_WALL, (0.90, 0.89, 0.86), (0.93, 0.92, 0.89), grain),
        (_ROOF, (0.40, 0.16, 0.12), (0.72, 0.36, 0.26), tiles),
        (_LAWN, (0.20, 0.32, 0.12), (0.48, 0.56, 0.28), 0.6 * grain + 0.5 * fine),
        (_TRUNK, (0.25, 0.17, 0.10), (0.40, 0.30, 0.20), grain),
        (_CROWN, (0.08, 0.22, 0.08), (0.38, 0.50, 0.22), leaves),
    ):
        mix = np.clip(0.5 + 0.5 * pattern, 0, 1)[:, None]
        chosen = kinds == kind
        albedo[chosen] = (np.array(low) * (1 - mix) + np.array(high) * mix)[chosen]
    is_window = window & (kinds == _WALL) & (np.abs(normals[:, 2]) < 0.5)
    albedo[is_window] = np.stack([0.20 + 0.08 * fine, 0.24 + 0.08 * grain, 0.30 + 0.05 * fine], -1)[is_window]
    light = 0.72 + 0.28 * np.maximum(normals @ (_SUN / np.linalg.norm(_SUN)), 0)
    return np.clip(albedo * light[:, None], 0, 1)


def sky_colors(directions: np.ndarray) -> np.ndarray:
    """`[R, 3]` of a pale horizon, a blue zenith and soft clouds, by unit direction."""
    x, y, z = directions.T
    height = np.clip(z, 0, 1)[:, None] ** 0.7
    blue = (1 - height) * np.array([0.82, 0.87, 0.92]) + height * np.array([0.28, 0.50, 0.84])
    wave = (
        np.sin(5 * x + 2 * z + 0.5) + np.sin(6 * y - 4 * z) + 0.7 * np.sin(9 * x - 7 * y) + 0.5 * np.sin(12 * z + 8 * y)
    )
    cloud = 0.55 / (1 + np.exp(-2.5 * (wave - 0.6)))[:, None]
    return blue * (1 - cloud) + 0.95 * cloud


def cameras() -> list[Camera]:
    """From standing height, along two thirds of a circle about the house, now nearer and now farther."""
    width, height = SIZE
    K = np.array([[FOCAL, 0, width / 2], [0, FOCAL, height / 2], [0, 0, 1]], np.float32)
    rng, found = np.random.default_rng(0), []
    for angle in np.linspace(np.radians(-210), np.radians(30), PHOTOS):
        far = rng.uniform(8.5, 11.5)
        eye = np.array([far * np.cos(angle), far * np.sin(angle), 1.6 + rng.uniform(-0.1, 0.1)])
        target = np.array([rng.uniform(-1, 0.5), 0, rng.uniform(2.4, 3.6)])
        viewmat = look_at(eye, target, np.array([0.0, 0.0, 1.0])).astype(np.float32)
        found.append(Camera(viewmat, K, width, height))  # pyright: ignore[reportArgumentType]
    return found


def photo(camera: Camera, mesh: Mesh, kinds: np.ndarray, cast: Cast) -> tuple[np.ndarray, np.ndarray]:
    """`[H, W, 3]` uint8 pixels, means over their area, and `[H, W]` the share of each that is sky."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K)
    count = SAMPLES
    x = ((np.arange(camera.width * count) + 0.5) / count - K[0, 2]) / K[0, 0]
    y = ((np.arange(camera.height * count) + 0.5) / count - K[1, 2]) / K[1, 1]
    local = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], -1).reshape(-1, 3)
    rays = local @ viewmat[:3, :3]
    hits = cast(viewmat_center(viewmat), rays)
    corners = mesh.vertices[mesh.faces[hits.faces]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals *= np.where(np.sum(normals * rays, 1, keepdims=True) > 0, -1, 1)
    is_sky = ~np.isfinite(hits.distances)
    colors = sky_colors(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    points = np.einsum("rk,rkc->rc", hits.barycentrics, corners)
    colors[~is_sky] = surface_colors(points, normals, kinds[hits.faces])[~is_sky]

    def mean(values: np.ndarray) -> np.ndarray:
        return values.reshape(camera.height, count, camera.width, count, -1).mean(axis=(1, 3))

    return np.rint(255 * mean(colors)).astype(np.uint8), mean(is_sky)[..., 0]


def make(folder: Path) -> None:
    """Photos, the model, `true_sky/` (0 where a photo shows sky) and `gt_mesh.ply`."""
    mesh, kinds = house()
    cast, views = ray_caster(mesh), cameras()
    for name in ("images", "true_sky"):
        make_folder(folder / name)
    photos = []
    for index, camera in enumerate(views):
        image, sky = photo(camera, mesh, kinds, cast)
        photos.append(image)
        write_image(folder / f"images/{index:03d}.png", image)
        write_image(folder / f"true_sky/{index:03d}.png", np.where(sky > 0.5, np.uint8(0), np.uint8(255)))
    write_mesh(folder / "gt_mesh.ply", mesh)
    _write_tracks(folder / "sparse/0", views, photos, mesh, cast)


def _write_tracks(folder: Path, views: list[Camera], photos: list[np.ndarray], mesh: Mesh, cast: Cast) -> None:
    """Points that at least three photos see, where the photos have contrast."""
    pycolmap = require("pycolmap", "pip install pycolmap")
    rng = np.random.default_rng(1)
    near = np.abs(mesh.vertices[mesh.faces]).max(axis=(1, 2)) < LAWN
    parts = [Mesh(mesh.vertices, mesh.faces[near], mesh.colors)]
    points = sample_surface(parts[0], POINTS, 1)[0].astype(np.float64)
    lawn = np.concatenate([rng.uniform(-12, 12, (POINTS // 3, 2)), np.zeros((POINTS // 3, 1))], 1)
    points = np.concatenate([points, lawn])
    seen, pixels = np.zeros((2, len(views), len(points)), bool)[0], np.zeros((len(views), len(points), 2))
    for index, (camera, image) in enumerate(zip(views, photos, strict=True)):
        viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
        at = landing(points, viewmat, K, (camera.height, camera.width))
        eye = viewmat_center(viewmat)
        free = cast(eye, points - eye).distances > 1 - 1e-3
        grey = image.mean(-1)
        contrast = np.hypot(*np.gradient(grey))[at.rows, at.columns]
        seen[index] = at.inside & free & (contrast > 5)
        local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
        pixels[index] = local[:, :2] / np.maximum(local[:, 2:], 1e-3) * np.diag(K)[:2] + K[:2, 2]
    pixels += rng.normal(0, TRACK_NOISE, pixels.shape)
    chosen = np.flatnonzero(seen.sum(0) >= 3)
    model, (width, height) = pycolmap.Reconstruction(), SIZE
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model="PINHOLE", width=width, height=height,
                        params=[FOCAL, FOCAL, width / 2, height / 2])
    )  # fmt: skip
    tracks = {point: [] for point in chosen}
    for index, camera in enumerate(views):
        observed = chosen[seen[index, chosen]]
        for order, point in enumerate(observed):
            tracks[point].append(pycolmap.TrackElement(index + 1, order))
        image = pycolmap.Image(f"{index:03d}.png", pixels[index, observed], 1, index + 1)
        pose = np.asarray(camera.viewmat, np.float64)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3]))
    for point in chosen:
        first = int(np.flatnonzero(seen[:, point])[0])
        column, row = np.clip(pixels[first, point], 0, [width - 1, height - 1]).astype(int)
        noisy = points[point] + rng.normal(0, 0.02, 3)
        model.add_point3D(noisy, pycolmap.Track(tracks[point]), photos[first][row, column])
    model.update_point_3d_errors()
    write_whole(model, folder)


def score(folder: Path, file: Path) -> dict[str, Any]:
    """How far a mesh is one of the house.

    Returns:
        Square metres of mesh that are farther than `OFF` from the truth, near the house, above its eaves and in all;
        square metres of the mesh; and the share of the house's own surface, as photos saw it, within `OFF` of the mesh.
    """
    truth, found = read_mesh(folder / "gt_mesh.ply"), read_mesh(file)
    o3d = require("open3d", "pip install open3d")

    def distances(points: np.ndarray, mesh: Mesh) -> np.ndarray:
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(np.ascontiguousarray(mesh.vertices, np.float32), mesh.faces.astype(np.uint32))
        return scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()

    corners = found.vertices[found.faces].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    middles = corners.mean(1)
    off = distances(middles, truth) > OFF
    near = (np.abs(middles[:, :2]) < AROUND).all(1)
    walls = np.abs(truth.vertices[truth.faces]).max(axis=(1, 2)) < LAWN
    samples = sample_surface(Mesh(truth.vertices, truth.faces[walls], truth.colors), 20_000, 0)[0]
    samples = samples[samples[:, 1] < 1.0]  # What is behind no photo shows.
    return {
        "off_near": float(areas[off & near].sum()),
        "off_over_eaves": float(areas[off & (middles[:, 2] > 3)].sum()),
        "off_all": float(areas[off].sum()),
        "area": float(areas.sum()),
        "complete": float((distances(samples, found) < OFF).mean()),
    }
