"""Poisson through points on the level set of the density: SuGaR's and the paper's method."""

from collections.abc import Iterable, Sequence

from gsjax.gaussians import Gaussians
from gsjax.meshing import level_set
from gsjax.meshing.level_set import LevelSetOptions
from gsjax.meshing.mesh_method import Method, SurfaceSamples, poisson_through
from gsjax.meshing.poisson import PoissonOptions
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera


def level_set_poisson(
    options: LevelSetOptions | None = None, reconstruction: PoissonOptions | None = None, *, seed: int = 0
) -> Method:
    """Return the method; its pictures need owners.

    Args:
        options: Of the sampling. None: `level_set.options_for` the cameras.
        reconstruction: Of the Poisson stage. None: its defaults.
        seed: Of the random choice of pixels.
    """

    def from_level_set(gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]) -> SurfaceSamples:
        surface = level_set.surface_points(gaussians, cameras, pictures, options, seed=seed)
        report = {
            "kernels": surface.kernels,
            "rays": surface.rays,
            "crossing_share": surface.crossing_share,
            "flipped_share": surface.flipped / surface.crossings,
            "points": len(surface.points),
        }
        build = poisson_through(gaussians, surface.points, surface.normals, surface.colors, reconstruction)
        return SurfaceSamples(surface.points, build, report)

    return from_level_set
