"""Train Gaussians on a data set.

Reads a COLMAP model (SCENE/images, SCENE/sparse/0), a transforms.json or a NeRF-synthetic
folder, and writes RUN/gaussians.ply, checkpoints, metrics.jsonl, and the settings in
RUN/config.json. Some photos are held out for `gsjax eval`: see --hold-out.

Example: gsjax train scenes/garden --out runs/garden --preset fast
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from gsjax import config
from gsjax.cli import environment
from gsjax.cli.parsers import Command, add_moved_scene, finite, seconds
from gsjax.cli.view import add_address
from gsjax.errors import InputError
from gsjax.presets import LENGTHS, PRESETS, settings_of, table
from gsjax.settings import Settings

OPTIONS = {
    "seed": "seed",
    **{name: f"photos.{name}" for name in ("downscale", "images", "hold_out", "masks")},
    **{name: f"supervision.{name}" for name in ("normals", "normal_axes", "depth", "depth_unit")},
    **{name: f"model.{name}" for name in ("points", "background")},
    **{name: f"schedule.{name}" for name in ("vanilla", "views_per_step")},
    "effects": "effects.names",
    "sky": "effects.sky",
}
"""Options -> the keys of the settings that they set."""
TRAINING = "seed", "downscale", "hold_out", "assignments"
"""Options of `add_training` besides the preset."""


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("scene", metavar="SCENE", nargs="?", help="folder of the data set; with --resume, that of RUN")
    add("--out", metavar="RUN", required=True, help="folder for the run; must be empty unless --resume")
    add(
        "--preset",
        choices=PRESETS,
        help="how long to train: quick, the images alone in a minute or two; minutes on a CPU; or the paper's budgets"
        " for a GPU (default: fast)",
    )
    add("--budget", metavar="TIME", help="how long the run may take on this machine, as in 90s, 10m or 1.5h: picks the"
        " preset, unless one is given, its steps, and, without `--set model.max_gaussians`, its Gaussians")  # fmt: skip
    add("--seed", type=int, metavar="N", help="seed of all random numbers (default: 0)")
    _add_inputs(add)
    _add_machines(add)
    add("--set", metavar="KEY=VALUE", action="extend", nargs="+", dest="assignments",
        help="any setting by its dotted key, as RUN/config.json shows them; may be repeated")  # fmt: skip
    add("--resume", action="store_true", help="continue RUN from its last checkpoint with its own settings")
    add_moved_scene(parser)
    add("--deterministic", action="store_true", help="the same bits in every run on a GPU, too, where sums by atomics"
        " differ from run to run; slower (a CPU's runs are the same without)")  # fmt: skip
    add("--view", action="store_true", help="show the training on a page in the browser, as `gsjax view` does")
    add_address(parser)


def _add_inputs(add: Callable[..., Any]) -> None:
    """The photos, and what else of the scene the training reads or simulates."""
    add("--downscale", type=finite, metavar="K", help="make the photos K times smaller (default: to 1600 pixels,"
        " and with fast on a CPU to what its minutes bear)")  # fmt: skip
    add("--images", metavar="FOLDER", help="folder of the photos, within SCENE or absolute; copies of another size"
        " rescale the cameras (default: images/, or the largest of images_2, images_4, images_8)")  # fmt: skip
    add("--hold-out", metavar="N|none|FILE", help="photos for scoring only: every N-th, none, or those that a text"
        " file names, one a line (default: the data set's own split, else 8)")  # fmt: skip
    add("--normals", metavar="DIR", nargs="?", const="auto", help="folder of normal maps (.npy, .npz or .png, named as"
        " the photos), or the name of one in SCENE, as in --normals moge2; without a value, the one that `gsjax"
        " normals` made there; without the option those of multi-view stereo, or smoothed ones of the rendered"
        " depth")  # fmt: skip
    add("--normal-axes", metavar="SIGNS", help="axes of the maps by ours (x right, y down, z forward): three"
        " signs, as in --normal-axes=+x-y-z, or opencv, opengl, dsine, pytorch3d (default: found by"
        " comparing)")  # fmt: skip
    add("--depth", metavar="DIR", nargs="?", const="auto", help="folder of measured depth, .png of 16 bits or .npy"
        " named as the photos, within SCENE or anywhere; without a value, the maps that transforms.json lists, or else"
        " SCENE/depth")  # fmt: skip
    add("--depth-unit", choices=("mm", "cm", "m", "scene"), help="unit of that depth (default: as depth.json next to"
        " the maps says, or transforms.json)")  # fmt: skip
    add("--sky", metavar="DIR", nargs="?", const="auto", help="make no surface of open sky: folder of masks, 0 where a"
        " photo shows sky, named as those in masks/, within SCENE or anywhere; without a value, it is found in the"
        " photos")  # fmt: skip
    add("--points", metavar="FILE", help="PLY of points to start from, as of a LiDAR scan, in the coordinates of SCENE"
        " (default: the data set's own)")  # fmt: skip
    add("--background", choices=("white", "black", "random"), help="colour behind the Gaussians (default: black)")
    add("--masks", choices=("valid", "matte"), help="what the masks/ folder means: pixels to use, or the object's"
        " coverage over the background (default: valid)")  # fmt: skip
    add("--effects", metavar="auto|none|NAMES", help="what photography added to the scene, to be simulated: auto,"
        " what the photos show (see `gsjax diagnose`); or names, as in exposure,poses (default: auto; none with the"
        " paper's presets)")  # fmt: skip
    add("--vanilla", action="store_const", const=True, help="vanilla 3DGS: photometric terms alone, without"
        " normals, stereo and sparse-view regularization")  # fmt: skip


def _add_machines(add: Callable[..., Any]) -> None:
    """Devices and processes that share the training."""
    add("--devices", metavar="N|all", help="share the photos of every step among so many devices, each with"
        " all Gaussians (default: 1; across machines: all)")  # fmt: skip
    add("--views-per-step", type=int, metavar="V", help="photos that a step takes, a multiple of the devices: fewer and"
        " longer steps, as many photos seen (default: as many as devices)")  # fmt: skip
    add("--coordinator", metavar="HOST:PORT|auto", help="train with other processes, all started with this command:"
        " where the first of them listens; auto reads it from the cluster's environment")  # fmt: skip
    add("--processes", type=int, metavar="P", help="how many processes there are, with --coordinator HOST:PORT")
    add("--process", type=int, metavar="I", help="which of them this is, from 0; the first alone writes RUN")


def run(
    out: str,
    scene: str | None = None,
    scene_folder: str | None = None,
    preset: str | None = None,
    budget: str | None = None,
    devices: str | None = None,
    coordinator: str | None = None,
    resume: bool = False,
    deterministic: bool = False,
    view: bool = False,
    **options: Any,
) -> dict[str, Any] | None:
    """Train; return the summary, in the first of several processes."""
    address, places = (
        {name: options.pop(name) for name in names if name in options}
        for names in (("port", "host"), ("processes", "process"))
    )
    if address and not view:
        raise InputError(f"--{next(iter(address))} goes with --view")
    if places and coordinator is None:
        raise InputError(f"--{next(iter(places))} goes with --coordinator")
    if deterministic:
        environment.ask_for_determinism()
    scene = _scene(out, scene, scene_folder, resume)
    used = _devices(devices, coordinator)
    train = partial(_train, scene, out, preset, budget, used, resume, address if view else None, options)
    if coordinator is None:
        return train()
    from gsjax.runs import processes

    with processes.join_processes(coordinator, **places):
        summary = train()
        return summary if processes.is_first() else None


def _train(
    scene: str,
    out: str,
    preset: str | None,
    budget: str | None,
    devices: int | Literal["all"],
    resume: bool,
    page: Mapping[str, Any] | None,
    options: Mapping[str, Any],
) -> dict[str, Any]:
    """Train in this process; `page` is where a page shows it, None: nowhere."""
    from gsjax import pipeline

    if devices != 1 or options.get("views_per_step", 1) > 1:
        for name, value in (("budget", budget), ("view", page is not None)):
            if value:
                raise InputError(f"--{name}: needs one device and --views-per-step 1")
    if page is not None:
        from gsjax import viewer

        viewer.check_port(**page)  # Before a budget is measured.
    spread: dict[str, Any] = {} if devices == 1 else {"devices": devices}
    if spread and not resume:
        options = {"views_per_step": pipeline.count_devices(devices), **options}
    plan = _settings(scene, out, preset, budget, resume, options)
    begin = partial(pipeline.train, scene, out, plan, resume=resume, **spread)
    if page is None:
        return begin()
    with viewer.watch(scene, plan, **page) as observe:
        return begin(observe=observe)


def _scene(out: str, scene: str | None, moved_to: str | None, resume: bool) -> str:
    """The data set: as given, or that of the run to resume, which is recorded where it was moved to."""
    if moved_to is not None:
        from gsjax.runs import is_run
        from gsjax.runs.relocation import relocate_scene

        if not resume:
            raise InputError("--scene: is the new place of a run's data set, and goes with --resume")
        if is_run(out):
            relocate_scene(out, moved_to)
        return moved_to
    if scene is not None:
        return scene
    if not resume:
        raise InputError("SCENE: name the folder of the data set, as in gsjax train SCENE --out RUN")
    from gsjax.runs.run import Run

    return Run.open(out).manifest["scene"]


def _devices(devices: str | None, coordinator: str | None) -> int | Literal["all"]:
    named = devices or ("1" if coordinator is None else "all")
    if named == "all":
        return "all"
    if not named.isdecimal() or int(named) < 1:
        raise InputError(f"--devices {named}: not a number of devices, nor all")
    return int(named)


def _settings(
    scene: str, out: str, preset: str | None, budget: str | None, resume: bool, options: Mapping[str, Any]
) -> Settings:
    """The run's settings: the preset (of a resumed run: what it was started with), the options, then `--set`.

    With a budget of time, as many steps of that, and Gaussians but where their number is set, as the machine bears.

    Raises:
        InputError: An unknown key, or a value of the wrong type or range.
    """
    from gsjax import pipeline, runs

    limit = None if budget is None else seconds(budget)
    started = Path(out) / "config.json"
    if resume and started.exists():
        stored = runs.read_settings(out)
        config.parse(Settings, stored, where=str(started))
        has_maps = stored.get("supervision", {}).get("normals") is not None
        return override_settings(
            config.merge(stored, table(preset, with_maps=has_maps)) if preset else stored, **options
        )
    if limit is None:
        return training(preset or "fast", **options)
    runs.require_free(out)
    candidates = {name: training(name, **options) for name in ((preset,) if preset else LENGTHS)}
    is_set = any(one.startswith("model.max_gaussians=") for one in options.get("assignments", ()))
    lasting = pipeline.scaled if is_set else pipeline.resized
    settings, line = pipeline.budgeted(scene, candidates, limit, lasting)
    print(f"budget of {budget}: {line}", file=sys.stderr)
    return settings


def add_training(parser: Command, length: str) -> None:
    """Add the arguments of `training`, for commands that train among other things; `length` says what a preset is."""
    add = parser.add_argument
    add("--preset", choices=PRESETS, default="fast", help=f"{length} (default: fast)")
    add("--seed", type=int, metavar="N", help="seed of all random numbers (default: 0)")
    add("--downscale", type=finite, metavar="K", help="make the photos K times smaller (default: as `gsjax train`)")
    add("--hold-out", metavar="N|none|FILE", help="photos for scoring only (default: as `gsjax train`)")
    add("--set", metavar="KEY=VALUE", action="extend", nargs="+", dest="assignments",
        help="any setting of the training by its dotted key; may be repeated")  # fmt: skip


def training(preset: str, **options: Any) -> Settings:
    """The settings of a preset, with the options of `TRAINING`; normal maps change weights (`gsjax.presets.table`)."""
    return settings_of(preset, partial(override_settings, **options))


def override_settings(base: Mapping[str, Any], assignments: Sequence[str] = (), **options: Any) -> Settings:
    """Settings with the options of `OPTIONS` that were given, then what `--set` says."""
    for name, exists in (
        ("hold_out", os.path.isfile),
        ("points", os.path.isfile),
        ("depth", os.path.isdir),
        ("sky", os.path.isdir),
    ):
        if exists(options.get(name, "")):  # As an absolute path, later commands find it from anywhere.
            options[name] = str(Path(options[name]).resolve())
    changes: dict[str, Any] = {}
    for name, value in options.items():
        *group, key = OPTIONS[name].split(".")
        (changes.setdefault(group[0], {}) if group else changes)[key] = value
    return config.parse_overridden(Settings, config.merge(base, changes), assignments)
