"""What a metre is in a scene, told by points that photos saw; and that training follows what was measured."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, fit, plane

from gsjax import rendering
from gsjax.errors import InputError
from gsjax.planning.depth_supervision import measured_depth
from gsjax.rendering import depth
from gsjax.scene import Pixels, Scene, Tracks, frame_of
from gsjax.scene.georeference import Place
from gsjax.scene.similarity import Similarity
from gsjax.settings import Model, Phase, Rates, Schedule, Settings, Supervision, Weights
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import plan
from gsjax.training.state import initial_state

CAMERAS = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-0.6, 0.0, 0.6)]
WALL = plane((0.1, 0.05, -1.0))
NORMAL = np.array([0.1, 0.05, -1.0])


def true_depth(camera):
    """`[H, W]` float64 camera z of the wall, which stands at (0, 0, 4)."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
    normal = viewmat[:3, :3] @ NORMAL
    offset = normal @ (viewmat[:3, :3] @ [0, 0, 4.0] + viewmat[:3, 3])
    return offset / (rays @ normal)


@pytest.fixture(scope="module")
def frames():
    """Photos of the wall, grey as it is."""
    grey = Pixels(np.full((24, 32, 3), 128, np.uint8))
    return tuple(frame_of(f"{i}.png", np.asarray(c.viewmat), np.asarray(c.K), grey) for i, c in enumerate(CAMERAS))


def scene_of(root, frames, *, similarity=None, noise=0.0, millimetres=2000, count=80):
    """Points of the wall that all photos see, and maps of it: a unit of the scene is so many millimetres."""
    rng = np.random.default_rng(0)
    at = rng.uniform(-0.8, 0.8, (count, 2))
    points = np.c_[at, 4 + (at @ NORMAL[:2]) / -NORMAL[2]].astype(np.float32)
    views = np.repeat(np.arange(len(frames)), count)
    camera_points = np.concatenate([points @ frame.viewmat[:3, :3].T + frame.viewmat[:3, 3] for frame in frames])
    tracks = Tracks(
        tuple(frame.name for frame in frames),
        views.astype(np.int32),
        np.tile(np.arange(count, dtype=np.int32), len(frames)),
        (camera_points[:, :2] / camera_points[:, 2:]).astype(np.float32),
    )
    (root / "depth").mkdir()
    for frame, camera in zip(frames, CAMERAS, strict=True):
        off = np.exp(noise * rng.normal(size=(frame.height, frame.width)))
        np.save(root / f"depth/{frame.name[0]}.npy", millimetres * true_depth(camera) * off)
    colors = np.full((count, 3), 128, np.uint8)
    more = {} if similarity is None else {"similarity": similarity}
    return Scene(root, "colmap", frames, points, colors, tracks=lambda: tracks, **more)


def test_points_tell_what_a_metre_is(tmp_path, frames):
    scene = scene_of(tmp_path, frames)
    measured = measured_depth(scene, Supervision(depth="depth", depth_unit="mm"))
    assert "of 3 of 3 photos, in mm; 1 m is 0.5" in measured.line
    for (depth_map, trust), camera in zip(measured.depths(1), CAMERAS, strict=True):
        # A point is up to half a pixel from the pixel's centre, on a slanted wall.
        np.testing.assert_allclose(depth_map, true_depth(camera), rtol=1e-3)
        assert (trust == 255).all()
    assert next(iter(measured.depths(2)))[0].shape == (12, 16)
    assert measured_depth(scene, Supervision()) is None


def test_a_scene_in_metres_or_without_tracks_takes_the_unit_at_its_word(tmp_path, frames):
    doubled = Similarity(2.0)  # of files in metres
    tracked = scene_of(tmp_path, frames, similarity=doubled, millimetres=500)
    bare, metres, unknown = replace(tracked, tracks=None), "the scene is in metres", "no points determine the"
    for scene, unit, of_millimetres, message in (
        (tracked, "mm", 1, metres),
        (bare, "mm", 1, unknown),
        (bare, "cm", 10, unknown),
        (bare, "m", 1000, unknown),
    ):
        measured = measured_depth(scene, Supervision(depth="depth", depth_unit=unit))
        assert message in measured.line
        depth_map = next(iter(measured.depths(1)))[0]
        np.testing.assert_allclose(depth_map, of_millimetres * true_depth(CAMERAS[0]), rtol=1e-5)
    placed = replace(tracked, place=Place(scale=3.0))  # a unit of the files is three metres
    own = measured_depth(placed, Supervision(depth="depth", depth_unit="scene"))
    np.testing.assert_allclose(next(iter(own.depths(1)))[0], 2 * 3 * 500 * true_depth(CAMERAS[0]), rtol=1e-5)


def test_maps_of_something_else_are_refused(tmp_path, frames):
    with pytest.raises(InputError, match=r"depth: its depth and the points of the scene differ by \d+ % at any scale"):
        measured_depth(scene_of(tmp_path, frames, noise=0.5), Supervision(depth="depth", depth_unit="mm"))


def test_the_term_is_in_every_phase_unless_a_phase_says_otherwise():
    phases = (Phase("a", 1), Phase("b", 1, Weights(measured_depth=0.7)), Phase("c", 1, Weights(measured_depth=0.0)))
    supervision = Supervision(depth="depth", depth_weight=0.3)
    planned = plan(Settings(supervision=supervision, schedule=Schedule(phases=phases)))
    weights = [{each.name: each.weight for each in phase.terms} for phase in planned.phases]
    assert [each.get("measured_depth") for each in weights] == [0.3, 0.7, None]
    with pytest.raises(InputError, match="phases.b.weights.measured_depth: needs measured depth .supervision.depth."):
        plan(Settings(schedule=Schedule(phases=phases)))
    with pytest.raises(ValueError, match="vanilla is plain 3DGS"):
        Settings(supervision=Supervision(depth="depth"), schedule=Schedule(vanilla=True))
    with pytest.raises(ValueError, match="depth_unit=mm is the unit of no maps"):
        Supervision(depth_unit="mm")


def rendered_error(gaussians):
    """Mean share by which the rendered depth of the middle camera is off."""
    rendered_depth, _ = jax.jit(lambda g: depth.expected_depth(rendering.splat(g, CAMERAS[1], 4096)))(gaussians)
    rendered_depth = np.asarray(rendered_depth)
    return np.abs(np.log(rendered_depth[rendered_depth > 0] / true_depth(CAMERAS[1])[rendered_depth > 0])).mean()


def test_training_comes_nearer_to_what_was_measured_than_without(frames):
    """From a wall that stands a twentieth too far; its photos have no texture. Without confidence there is no term."""
    trust = np.full((24, 32), 255, np.uint8)
    settings = Settings(
        schedule=Schedule(phases=(Phase("all", 60, Weights(dssim=0.0)),)),
        supervision=Supervision(depth="depth", depth_weight=1.0),
        model=Model(sh_degree=0),
        rates=Rates(means=0.01),
    )
    start = replace(WALL, means=1.05 * WALL.means)
    optimizer = make_optimizer(settings.rates, 1.0, 100_000)  # which falls by a hundredth in these steps
    errors = []
    for confidence in (trust, 0 * trust):
        maps = [(true_depth(camera).astype(np.float32), confidence) for camera in CAMERAS]
        maps[0][0][:, :9] = 0.0
        maps[1][0][:, 9:12] = np.nan
        state = initial_state(jax.tree.map(jnp.copy, start), optimizer)
        watch = {"normal_source": lambda state: [], "observe": lambda progress: None}
        final = fit(settings, frames, 1.0, state, optimizer, depths=lambda scale, maps=maps: maps, **watch)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(final.gaussians))
        errors.append(rendered_error(final.gaussians))
    before = rendered_error(start)
    assert before > 0.03
    assert errors[0] < 0.3 * before
    assert errors[0] < 0.6 * errors[1]
