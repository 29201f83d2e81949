"""`gsjax train`: a data set to Gaussians."""

import argparse
import os
import sys
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

from gsjax import config
from gsjax.cli import environment
from gsjax.cli.parsers import add_command, add_moved_scene, finite, given_options, seconds
from gsjax.cli.view import add_address
from gsjax.errors import InputError
from gsjax.presets import LENGTHS, PRESETS
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
FEW_OPTIONS = "seed", "downscale", "hold_out"
"""Of `add_training`."""


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "train",
        _run,
        summary="train Gaussians on a data set",
        description="""
            Reads a COLMAP model (SCENE/images, SCENE/sparse/0), a transforms.json or a NeRF-synthetic
            folder, and writes RUN/gaussians.ply, checkpoints, metrics.jsonl, and the settings in
            RUN/config.json. Some photos are held out for `gsjax eval`: see --hold-out.
        """,
        example="gsjax train scenes/garden --out runs/garden --preset fast",
    )
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
    add("--downscale", type=finite, metavar="K", help="make the photos K times smaller (default: to 1600 pixels,"
        " and with fast on a CPU to what its minutes bear)")  # fmt: skip
    add("--images", metavar="FOLDER", help="folder of the photos, within SCENE or absolute; copies of another size"
        " rescale the cameras (default: images/, or the largest of images_2, images_4, images_8)")  # fmt: skip
    add("--hold-out", metavar="N|none|FILE", help="photos for scoring only: every N-th, none, or those that a text"
        " file names, one a line (default: the data set's own split, else 8)")  # fmt: skip
    add("--normals", metavar="DIR", nargs="?", const="auto", help="folder of normal maps (.npy, .npz or .png, named as"
        " the photos), or the name of one in SCENE, as in --normals moge2; without a value, the one that `gsjax"
        " normals` made there; without the option the first phase's own smoothed depth normals serve")  # fmt: skip
    add("--normal-axes", metavar="SIGNS", help="what brings the maps' axes to ours (x right, y down, z forward): three"
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
    add("--vanilla", action="store_const", const=True, help="plain 3DGS: leave the normal term out")
    add("--devices", metavar="N|all", help="share the photos of every step among so many devices, each with"
        " all Gaussians (default: 1; across machines: all)")  # fmt: skip
    add("--views-per-step", type=int, metavar="V", help="photos that a step takes, a multiple of the devices: fewer and"
        " longer steps, as many photos seen (default: as many as devices)")  # fmt: skip
    add("--coordinator", metavar="HOST:PORT|auto", help="train with other processes, all started with this command:"
        " where the first of them listens; auto reads it from the cluster's environment")  # fmt: skip
    add("--processes", type=int, metavar="P", help="how many processes there are, with --coordinator HOST:PORT")
    add("--process", type=int, metavar="I", help="which of them this is, from 0; the first alone writes RUN")
    add("--set", metavar="KEY=VALUE", action="append", nargs="+", default=[], dest="assignments",
        help="any setting by its dotted key, as RUN/config.json shows them; may be repeated")  # fmt: skip
    add("--resume", action="store_true", help="continue RUN from its last checkpoint with its own settings")
    add_moved_scene(parser)
    add("--deterministic", action="store_true", help="the same bits in every run on a GPU, too, where sums by atomics"
        " differ from run to run; slower (a CPU's runs are the same without)")  # fmt: skip
    add("--view", action="store_true", help="show the training on a page in the browser, as `gsjax view` does")
    add_address(parser)


def _run(arguments: argparse.Namespace) -> None:
    address, places = given_options(arguments, "port", "host"), given_options(arguments, "processes", "process")
    if address and not arguments.view:
        raise InputError(f"--{next(iter(address))} goes with --view")
    if places and arguments.coordinator is None:
        raise InputError(f"--{next(iter(places))} goes with --coordinator")
    if arguments.deterministic:
        environment.ask_for_determinism()
    from gsjax.report import tables

    arguments.scene = _scene(arguments)
    if arguments.coordinator is None:
        print(tables.record(_train(arguments, address)))
        return
    from gsjax.runs import processes

    with processes.join_processes(arguments.coordinator, **places):
        summary = _train(arguments, address)
        if processes.is_first():
            print(tables.record(summary))


def _train(arguments: argparse.Namespace, address: dict[str, Any]) -> dict[str, Any]:
    from gsjax import pipeline

    devices = _devices(arguments)
    if devices != 1 or (arguments.views_per_step or 1) > 1:
        for name in ("budget", "view"):
            if getattr(arguments, name):
                raise InputError(f"--{name}: needs one device and --views-per-step 1")
    if arguments.view:
        from gsjax import viewer

        viewer.check_port(**address)  # Before a budget is measured.
    if devices != 1 and arguments.views_per_step is None and not arguments.resume:
        arguments.views_per_step = pipeline.count_devices(devices)
    plan, spread = settings(arguments), {"devices": devices} if devices != 1 else {}
    train = partial(pipeline.train, arguments.scene, arguments.out, plan, resume=arguments.resume, **spread)
    if not arguments.view:
        return train()
    with viewer.watch(arguments.scene, plan, **address) as observe:
        return train(observe=observe)


def _scene(arguments: argparse.Namespace) -> str:
    """The data set: as given, or that of the run to resume, which is recorded where it was moved to."""
    if arguments.scene_folder is not None:
        from gsjax.runs import is_run
        from gsjax.runs.relocation import relocate_scene

        if not arguments.resume:
            raise InputError("--scene: is the new place of a run's data set, and goes with --resume")
        if is_run(arguments.out):
            relocate_scene(arguments.out, arguments.scene_folder)
        return arguments.scene_folder
    if arguments.scene is not None:
        return arguments.scene
    if not arguments.resume:
        raise InputError("SCENE: name the folder of the data set, as in gsjax train SCENE --out RUN")
    from gsjax.runs.run import Run

    return Run.open(arguments.out).manifest["scene"]


def _devices(arguments: argparse.Namespace) -> int | Literal["all"]:
    named = arguments.devices or ("1" if arguments.coordinator is None else "all")
    if named == "all":
        return "all"
    if not named.isdecimal() or int(named) < 1:
        raise InputError(f"--devices {named}: not a number of devices, nor all")
    return int(named)


def settings(arguments: argparse.Namespace) -> Settings:
    """The run's settings: the preset (of a resumed run: what it was started with), the options, then `--set`.

    With a budget of time, as many steps of that, and Gaussians but where their number is set, as the machine bears.

    Raises:
        InputError: An unknown key, or a value of the wrong type or range.
    """
    from gsjax import pipeline, runs

    budget = None if arguments.budget is None else seconds(arguments.budget)
    started = Path(arguments.out) / "config.json"
    if arguments.resume and started.exists():
        base = config.merge(runs.read_settings(started.parent), PRESETS.get(arguments.preset, {}))
        return override_settings(base, arguments)
    if budget is None:
        return override_settings(PRESETS[arguments.preset or "fast"], arguments)
    runs.require_free(arguments.out)
    names = (arguments.preset,) if arguments.preset else LENGTHS
    candidates = {name: override_settings(PRESETS[name], arguments) for name in names}
    is_set = any(one.startswith("model.max_gaussians=") for group in arguments.assignments for one in group)
    lasting = pipeline.scaled if is_set else pipeline.resized
    chosen, line = pipeline.budgeted(arguments.scene, candidates, budget, lasting)
    print(f"budget of {arguments.budget}: {line}", file=sys.stderr)
    return chosen


def add_training(parser: argparse.ArgumentParser, length: str) -> None:
    """What commands that train among other things let choose of it; `training` reads it.

    Args:
        parser: Of the command.
        length: What its preset decides, for the help.
    """
    add = parser.add_argument
    add("--preset", choices=PRESETS, default="fast", help=f"{length} (default: fast)")
    add("--seed", type=int, metavar="N", help="seed of all random numbers (default: 0)")
    add("--downscale", type=finite, metavar="K", help="make the photos K times smaller (default: as `gsjax train`)")
    add("--hold-out", metavar="N|none|FILE", help="photos for scoring only (default: as `gsjax train`)")
    add("--set", metavar="KEY=VALUE", action="append", nargs="+", default=[], dest="assignments",
        help="any setting of the training by its dotted key; may be repeated")  # fmt: skip


def training(arguments: argparse.Namespace) -> Settings:
    """The settings that were chosen so."""
    return override_settings(PRESETS[arguments.preset], arguments, FEW_OPTIONS)


def override_settings(
    base: Mapping[str, Any], arguments: argparse.Namespace, names: Iterable[str] = OPTIONS
) -> Settings:
    """Settings with the named options where they were given, then what `--set` says."""
    options = given_options(arguments, *names)
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
    # Parsed before the overrides too, so that `--set` reaches into defaults that are lists.
    whole = config.to_dict(config.parse(Settings, config.merge(base, changes), where="settings"))
    assignments = [one for group in arguments.assignments for one in group]
    return config.parse(Settings, config.override(whole, assignments), where="--set")
