"""A ball on the ground made of flat Gaussians, with the exact depth that its cameras see."""

import sys
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial import KDTree
from small_scenes import discs

from gsjax.gaussians import Gaussians
from gsjax.meshing.level_set import world_points
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera, look_at

RADIUS = 1.0


@dataclass(frozen=True)
class DiscScene:
    """Gaussians, and per view a camera, exact depth (camera z, 0: nothing), alpha and colour."""

    gaussians: Gaussians
    cameras: list[Camera]
    depths: list[np.ndarray]
    alphas: list[np.ndarray]
    colors: list[np.ndarray]

    @property
    def pictures(self):
        """What a renderer would give for the cameras."""
        maps = zip(self.colors, self.depths, self.alphas, self.owners, strict=True)
        return [Picture(*parts) for parts in maps]

    @property
    def owners(self):
        """The Gaussian nearest to what each pixel shows, -1 where it shows nothing."""
        tree = KDTree(np.asarray(self.gaussians.means))
        hits = [
            world_points(c, d, *np.indices(d.shape).reshape(2, -1))[0]
            for c, d in zip(self.cameras, self.depths, strict=True)
        ]
        nearest = [tree.query(points)[1].reshape(d.shape) for points, d in zip(hits, self.depths, strict=True)]
        return [np.where(d > 0, ids, -1).astype(np.int32) for ids, d in zip(nearest, self.depths, strict=True)]

    @property
    def views(self):
        """The two arguments after the Gaussians of everything that extracts a surface."""
        return self.cameras, self.pictures


@pytest.fixture(scope="session")
def ball() -> DiscScene:
    """2,000 discs on the unit sphere about the origin, seen from 10 sides, orange."""
    return disc_scene(*sphere_samples(2000), discs_radius=0.06, cameras=_around(10), ground=None)


@pytest.fixture(scope="session")
def ball_on_ground() -> DiscScene:
    """The ball resting on a square of the plane z = -1, seen from 8 sides from above."""
    points, normals = sphere_samples(2000)
    x, y = np.meshgrid(np.linspace(-2.5, 2.5, 50), np.linspace(-2.5, 2.5, 50))
    ground = np.stack([x.ravel(), y.ravel(), np.full(x.size, -1.0)], axis=-1)
    ups = np.tile([0.0, 0.0, 1.0], (len(ground), 1))
    cameras = _around(8, heights=(2.0, 3.0))
    return disc_scene(np.r_[points, ground], np.r_[normals, ups], discs_radius=0.07, cameras=cameras, ground=-1.0)


def sphere_samples(count):
    """Evenly spread points on the unit sphere (golden spiral), which are their own normals."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    points = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=-1)
    return points, points


def disc_scene(points, normals, *, discs_radius, cameras, ground) -> DiscScene:
    """Discs of a twentieth of their radius in thickness, tangent to the surface."""
    depths = [_exact_depth(camera, ground) for camera in cameras]
    orange = np.array([1.0, 0.5, 0.0], np.float32)
    return DiscScene(
        gaussians=discs(points, normals, discs_radius, thickness=1 / 20, opacity=0.9),
        cameras=cameras,
        depths=depths,
        alphas=[(depth > 0).astype(np.float32) for depth in depths],
        colors=[np.broadcast_to(orange, (*depth.shape, 3)) for depth in depths],
    )


def _around(count, heights=(-2.5, 0.0, 2.5)) -> list[Camera]:
    """Cameras at distance about 4 that look at the origin, heights in turn."""
    K = np.array([[90.0, 0, 33], [0, 95.0, 30], [0, 0, 1]], np.float32)
    cameras = []
    for index in range(count):
        angle = 2 * np.pi * index / count
        eye = np.array([3.5 * np.cos(angle), 3.5 * np.sin(angle), heights[index % len(heights)]])
        cameras.append(Camera(look_at(eye, np.zeros(3), np.array([0.0, 0, 1])), K, 64, 60))
    return cameras


def _exact_depth(camera: Camera, ground: float | None) -> np.ndarray:
    """Camera z of the unit sphere, and of the plane z = ground within |x|, |y| < 2.5, at pixel centres."""
    viewmat, K = camera.viewmat.astype(np.float64), camera.K.astype(np.float64)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1) @ viewmat[:3, :3]
    eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
    a, b, c = np.sum(rays * rays, -1), rays @ eye, eye @ eye - RADIUS**2
    inside = b * b - a * c
    depth = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    if ground is not None:
        on_plane = (ground - eye[2]) / rays[..., 2]
        where = eye + on_plane[..., None] * rays
        on_square = (on_plane > 0) & np.all(np.abs(where[..., :2]) < 2.5, axis=-1)
        depth = np.minimum(depth, np.where(on_square, on_plane, np.inf))
    return np.where(np.isfinite(depth), depth, 0).astype(np.float32)


@pytest.fixture
def own_environment(monkeypatch, tmp_path):
    """What a command sets for jax stays inside the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.delenv("XLA_FLAGS")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")


@dataclass(frozen=True)
class SfmReport:
    registered: int
    left_out: dict[str, str]
    passed_over: dict[str, str] = field(default_factory=dict)
    gps_unused: dict[str, str] = field(default_factory=dict)
    focal_unused: dict[str, str] = field(default_factory=dict)
    images: int = 100


@pytest.fixture
def library(monkeypatch):
    """Stands in for the functions that the commands call, and records their arguments."""
    calls = []

    def install(name, **contents):
        package, module = sys.modules[name.rpartition(".")[0]], ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.setattr(package, name.rpartition(".")[2], module, raising=False)

    def recorded(name, result):
        def function(*args, **kwargs):
            calls.append((name, args, kwargs))
            return result

        return function

    names = ("train", "mesh", "normals", "masks", "evaluate", "render", "undistort", "report", "compare")
    functions = {name: recorded(name, {"psnr": 29.5, "views": 7}) for name in names}
    install("gsjax.pipeline", **functions, record_stage=lambda run, stage, work: work())
    left_out = {"a.jpg": "blurred", "b.jpg": "dark", "c.jpg": "dark"}
    install("gsjax.io.sfm", reconstruct=recorded("sfm", SfmReport(45, left_out)))
    report = {"vanilla": {"psnr": 30.0, "chamfer": 0.004}, "surface": {"psnr": 31.0}, "floor": {"chamfer": 1e-4}}
    install("gsjax.pipeline.demo", run=recorded("demo", report))

    @contextmanager
    def watch(*args, **kwargs):
        calls.append(("watch", args, kwargs))
        yield "told of every step"

    install("gsjax.viewer", view=recorded("view", None), watch=watch, check_port=lambda **address: None)
    return calls
