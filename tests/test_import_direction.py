"""The arrows between the layers, read from the source, and what `import gsjax` must not load."""

import ast
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PEERS = ("gsplat", "torch", "lpips")
OF_TESTS = ("hard_cases_page", "hard_scenes", "plain_places", "plain_scenes", "scenes")  # modules of the tests
SCRIPTS = [path.stem for path in (ROOT / "experiments").rglob("*") if path.suffix == ".py" or path.is_dir()]


@dataclass(frozen=True)
class Layer:
    """Modules (by dotted prefix), the layers below that they may import, and the packages that they may."""

    modules: tuple[str, ...]
    below: tuple[str, ...]
    packages: tuple[str, ...]


CORE_PACKAGES = ("jax", "jaxtyping", "numpy", "optax", "scipy")
CORE = ("vocabulary", "metrics", "normals", "analytic", "effects", "training", "binding")
FILES = ("io", "meshing", "networks", "runs")
LAYERS = {
    "native loops": Layer(("rasterizer._native",), ("rasterizer",), ("jax", "numpy", "numba", "llvmlite")),
    "rasterizer": Layer(("rasterizer",), ("native loops",), ("jax", "jaxtyping", "numpy")),
    "vocabulary": Layer(("gsjax",), ("rasterizer",), CORE_PACKAGES),
    "metrics": Layer(("gsjax.metrics",), ("rasterizer", "vocabulary"), CORE_PACKAGES),
    "normals": Layer(("gsjax.normals",), ("vocabulary",), CORE_PACKAGES),
    "analytic": Layer(("gsjax.analytic",), ("vocabulary", "metrics"), CORE_PACKAGES),
    "effects": Layer(("gsjax.effects",), ("vocabulary",), CORE_PACKAGES),
    "training": Layer(
        ("gsjax.training",), ("rasterizer", "vocabulary", "metrics", "normals", "effects"), CORE_PACKAGES
    ),
    "binding": Layer(("gsjax.binding",), ("rasterizer", "vocabulary", "metrics", "training"), CORE_PACKAGES),
    "io": Layer(
        ("gsjax.io",),
        ("vocabulary", "analytic", "normals"),
        ("jax", "numpy", "scipy", "tqdm", "cv2", "PIL", "pycolmap"),
    ),
    "networks": Layer(("gsjax.networks",), ("vocabulary", "normals", "io"), ("jax", "numpy", "cv2", "onnxruntime")),
    "stereo": Layer(("gsjax.stereo",), ("vocabulary", "io"), ("jax", "numpy", "scipy", "cv2", "tqdm")),
    "meshing": Layer(
        ("gsjax.meshing",),
        ("vocabulary", "io"),
        ("jax", "numpy", "scipy", "tqdm", "open3d", "trimesh", "xatlas", "PIL"),
    ),
    "runs": Layer(("gsjax.runs",), (*CORE, "io", "stereo", "meshing"), ("jax", "numpy", "tqdm")),
    "metrics of runs": Layer(
        tuple(f"gsjax.metrics.{name}" for name in ("lpips", "mesh_photos", "photos", "truth_maps")),
        (*CORE, *FILES),
        ("jax", "numpy"),
    ),
    "planning": Layer(
        ("gsjax.planning",), (*CORE, "io", "stereo", "meshing", "runs"), ("jax", "numpy", "optax", "scipy", "tqdm")
    ),
    "report": Layer(
        ("gsjax.report",),
        (*CORE, "io", "meshing", "runs", "metrics of runs"),
        ("jax", "numpy", "tqdm", "matplotlib", "jinja2"),
    ),
    "sharing": Layer(("gsjax.sharing",), (), ()),
    "pipeline": Layer(
        ("gsjax.pipeline",),
        ("rasterizer", *CORE, *FILES, "stereo", "metrics of runs", "planning", "report", "sharing"),
        ("jax", "numpy", "optax", "scipy", "tqdm", "matplotlib", "jinja2"),
    ),
    "viewer": Layer(
        ("gsjax.viewer",),
        ("rasterizer", *CORE, *FILES, "metrics of runs", "planning", "report", "pipeline"),
        ("jax", "numpy", "scipy", "viser", "rich", "websockets"),
    ),
    "cli": Layer(
        ("gsjax.cli", "gsjax.__main__"),
        (*CORE, *FILES, "metrics of runs", "planning", "report", "pipeline", "viewer"),
        (),
    ),
    "experiments": Layer(
        ("experiments",),
        ("rasterizer", *CORE, *FILES, "metrics of runs", "planning", "report", "pipeline", "viewer", "cli"),
        # Among them peers to time ours against, the cases to measure them on, and the scripts themselves: one imports
        # another by its bare name.
        ("jax", "numpy", "optax", "scipy", "tqdm", "matplotlib", "cv2", "pycolmap", "websockets")
        + (*PEERS, *OF_TESTS, *SCRIPTS),
    ),
}
HEAVY = {"numba", "open3d", "pycolmap", "cv2", "onnxruntime", "trimesh", "xatlas", "matplotlib", "PIL", "viser"}


def layer_of(module: str) -> str | None:
    """The layer with the longest prefix of a module's name; None for other people's packages."""
    prefixes = [(prefix, name) for name, layer in LAYERS.items() for prefix in layer.modules]
    owners = [(prefix, name) for prefix, name in prefixes if f"{module}.".startswith(f"{prefix}.")]
    return max(owners, key=lambda owner: len(owner[0]))[1] if owners else None


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imports(source: str) -> set[str]:
    """Every module that the source imports, anywhere in it; `from a import b` may mean the module a.b."""
    modules = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            modules |= {resolved(node.module, alias.name) for alias in node.names}
    return modules


def resolved(module: str, name: str) -> str:
    path = ROOT.joinpath(*module.split("."), name)
    return f"{module}.{name}" if path.is_dir() or path.with_suffix(".py").exists() else module


def faults(module: str, source: str) -> list[str]:
    """The imports of a module that its layer has no right to."""
    own = layer_of(module)
    layer = LAYERS[own]
    wrong = []
    for imported in sorted(imports(source)):
        target = layer_of(imported)
        package = imported.split(".")[0]
        if target is None:
            allowed = package in sys.stdlib_module_names or package in layer.packages
        else:
            allowed = target == own or target in layer.below
        if not allowed:
            wrong.append(f"{module} ({own}) imports {imported}")
    return wrong


SOURCES = sorted(path for package in ("rasterizer", "gsjax", "experiments") for path in (ROOT / package).rglob("*.py"))


def test_a_module_imports_from_its_own_layer_and_below():
    assert not [fault for path in SOURCES for fault in faults(module_name(path), path.read_text())]


@pytest.mark.parametrize(
    ("module", "source", "is_fine"),
    [
        ("rasterizer.api", "import jax.numpy as jnp", True),
        ("rasterizer.api", "from gsjax.scene import cameras", False),
        ("gsjax.training.terms.losses", "from gsjax.scene.cameras import Camera", True),
        ("gsjax.training.terms.losses", "def f():\n    import open3d", False),
        ("gsjax.io.ply", "import pycolmap", True),
        ("gsjax.io.ply", "from gsjax.meshing import poisson", False),
    ],
)
def test_the_check_itself_tells_right_from_wrong(module, source, is_fine):
    assert (faults(module, source) == []) == is_fine


def test_import_gsjax_is_quick_and_loads_nothing_heavy():
    core = [module_name(path) for path in SOURCES if layer_of(module_name(path)) in ("rasterizer", *CORE)]
    program = f"""
import sys, time
start = time.perf_counter()
import gsjax
assert "jax" not in sys.modules
seconds = time.perf_counter() - start
import {", ".join(core)}
assert seconds < 3, seconds
print(*({HEAVY} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""
