"""A run folder: settings, machine, metrics, checkpoints and results of a training or a refinement.

    config.json        the settings
    plan.json          what runs: phases with steps, terms and weights, and what the run found out for itself
    manifest.json      scene, command, versions, machine, seed, dates, status, the list of files, the `split` of the
                       photos by name (`gsjax.runs.splits`), and the `similarity` to the coordinates of the checkpoints
                       from those of all other files (`gsjax.scene.similarity`)
    place.json         where that is known: the unit of those other files, which way is up, and where on Earth they are
                       counted from (`gsjax.scene.georeference`)
    metrics.jsonl      one line per logged step
    pictures/          a few held-out views, as the report shows them
    report.html        the report (`gsjax.report.page`)
    checkpoints/       step_0001234.npz, the last two
    gaussians.ply      the result, for viewers
    cameras.json       the views it was trained on and scored on
    effects.json       what each photo made of the light, where a run simulates that
    poses.json         where cameras went from those of the data set, where a run moves them: cameras.json has the moved
    background.json    what is behind all Gaussians, where a run learns that
    masks/             0007.png of every training view with pixels that must not be used: 0 there, else 255

`create` starts one, `reopen` continues one; both leave a whole run folder. `claim_run` keeps it for one process, by a
lock (`.lock`) that ends with it. Every write is whole or not at all.
"""

import json
import re
import shlex
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gsjax import config
from gsjax.config import refuse_moved
from gsjax.errors import InputError
from gsjax.io import georeference_files, json_files
from gsjax.io.files import atomic_folder, atomic_path, make_folder, unwritable
from gsjax.io.json_shapes import check
from gsjax.io.locks import LOCK, lock_folder
from gsjax.io.machine import machine, versions
from gsjax.io.temporary_files import is_temporary, sweep
from gsjax.runs import checkpoints
from gsjax.runs.records import RECORD, SCENE, SETTINGS, STATUS
from gsjax.runs.splits import Split, split_record
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.similarity import IDENTITY, Similarity, parse_similarity
from gsjax.settings import Settings, group_flat

EARLIER: dict[str, Any] = {
    "photos": {},
    "supervision": {},
    "model": {"depth_mode": "center", "pixel_filter": "classic"},
    "schedule": {},
    "effects": {"names": "none"},
}
"""What runs did before they could choose."""
KEPT_CHECKPOINTS = 2  # The newest and, should it turn out damaged, the one before.
OF_A_BEGINNING = {"config.json", "plan.json", georeference_files.FILE, LOCK}
"""What a folder may hold that was to become a run: without a manifest it is none."""


def is_run(run: str | Path) -> bool:
    """Whether a folder holds a run."""
    return (Path(run) / "manifest.json").is_file()


def is_finished(run: str | Path) -> bool:
    """Whether a folder holds a run that came to its end."""
    return is_run(run) and json_files.read(Path(run) / "manifest.json", STATUS)["status"] == "done"


def require_free(run: str | Path) -> None:
    """Raises InputError where the folder of a new run holds something already."""
    run = Path(run)
    if run.is_dir() and not all(map(_is_of_a_beginning, run.iterdir())):
        raise InputError(f"{run}: this folder is not empty; resume its run, or choose another")


def can_resume(run: str | Path) -> bool:
    """Whether there is a run to resume. A line reports a run that was stopped before its manifest: it starts again.

    Raises:
        InputError: There is no such folder, something else is in it, or another process is at work in it.
    """
    run = Path(run)
    if is_run(run):
        file = run / "config.json"
        refuse_moved(Settings, json_files.read(file, {}), where=f"{file}: of an earlier version")
        with lock_folder(run):
            return True
    if not run.is_dir():
        raise InputError(f"{run}: there is no run to resume; without resume one begins")
    if not all(map(_is_of_a_beginning, run.iterdir())):
        raise InputError(f"{run}: holds no manifest.json; it is no run folder")
    print(f"{run}: a run was stopped as it began here; it begins anew", file=sys.stderr)
    return False


def create(
    run: str | Path,
    settings: Mapping[str, Any],
    *,
    scene: str | Path,
    seed: int,
    similarity: Similarity = IDENTITY,
    place: Place = UNPLACED,
    plan: Mapping[str, Any] | None = None,
    split: Split | None = None,
) -> Path:
    """Makes the folder of a new run, with its config, plan and manifest: whole, or not at all.

    `settings` are those of `gsjax.config.to_dict`, and the plan is of `gsjax.training.plan.plan_record`. The similarity
    is to the run's own coordinates from those of the world, the place to the world from those of the data set.

    Raises:
        InputError: The folder holds something already, or cannot be written.
    """
    run = Path(run)
    require_free(run)
    manifest = {
        "scene": str(Path(scene).resolve()),
        "command": shlex.join(sys.argv),
        "seed": seed,
        "similarity": asdict(similarity),
        **({} if split is None else {"split": split_record(split)}),
        "created": _now(),
        "versions": versions(),
        "machine": machine(),
        "status": "started",
    }
    files = {"config.json": settings, "plan.json": plan, "manifest.json": manifest}  # The last makes it a run.
    # The folder may be a mount point, which cannot be replaced.
    with lock_folder(run) if run.is_dir() else atomic_folder(run) as folder:
        place_of_files = folder or run
        require_free(run)
        make_folder(place_of_files / "checkpoints")
        georeference_files.write_place(place_of_files, place)
        for name, data in files.items():
            if data is not None:
                json_files.write(place_of_files / name, data)
    return run


def _is_of_a_beginning(path: Path) -> bool:
    """Whether a file or folder is what we leave in one that is to become a run."""
    if path.name == "checkpoints" and path.is_dir():
        return all(map(is_temporary, path.iterdir()))
    return path.name in OF_A_BEGINNING or is_temporary(path)


def reopen(run: str | Path, settings: Mapping[str, Any], *, scene: str | Path) -> Path:
    """Opens the folder of a run to continue it on the data set and with the settings it was started with.

    Raises:
        InputError: It is no run folder, or the data set or a setting differs; the message names the first that does.
    """
    run = Path(run)
    started = json_files.read(run / "config.json", {})
    require_scene(run, scene)
    for key, (before, now) in _differences(started, json_files.plain(settings)).items():
        raise InputError(f"{run}: was started with {key} = {before}, not {now}; a resumed run keeps its settings")
    return run


def require_scene(run: str | Path, scene: str | Path) -> None:
    """Raises InputError where a run was begun on another data set, or the data set was moved."""
    before = json_files.read(Path(run) / "manifest.json", SCENE)["scene"]
    if before != str(Path(scene).resolve()):
        raise InputError(
            f"{run}: was started on {before}, not on {scene}; a resumed run keeps its data set, and --scene {scene}"
            " says that it was moved there"
        )


@contextmanager
def claim_run(run: Path) -> Iterator[None]:
    """Hold the lock of a run folder, without temporary files of killed processes.

    Bad input that ends a run before its first metrics and checkpoint deletes its files, so that the folder is free for
    other settings. Files that are not of a run stay.

    Raises:
        InputError: Another process is at work in it, or its only checkpoint is damaged.
    """
    with lock_folder(run):
        sweep(run)
        _drop_damaged_checkpoints(run)
        try:
            yield
        except InputError:
            if not read_metrics(run) and latest_checkpoint(run) is None:
                _forget(run)
            raise


def _drop_damaged_checkpoints(run: Path) -> None:
    """Leaves the newest that is whole. One line says which are gone."""
    while candidates := _checkpoints(run):
        try:
            checkpoints.load_arrays(candidates[-1][1])
            return
        except InputError as error:
            if len(candidates) == 1:
                raise InputError(f"{error}; without this file, resuming begins at the first step") from error
            print(f"{error}; resuming from {candidates[-2][1].name}", file=sys.stderr)
            candidates[-1][1].unlink()


def _forget(run: Path) -> None:
    """Removes what is ours of a run that came to nothing; and the folder, if that was all and it is no link."""
    maps = run / "normals"
    files = [run / name for name in (*OF_A_BEGINNING, "manifest.json", "metrics.jsonl")]
    for file in (*files, *maps.rglob("*.png")):
        file.unlink(missing_ok=True)
    for folder in (*(path for path in maps.rglob("*") if path.is_dir()), maps, run / "checkpoints", run):
        with suppress(OSError):  # Not empty, absent, or a link.
            folder.rmdir()


def update_manifest(run: str | Path, **changes: Any) -> None:
    """Sets entries of the manifest (`status="done"`, `train_seconds=...`) and lists the files anew."""
    run = Path(run)
    files = sorted(p.relative_to(run).as_posix() for p in run.rglob("*") if p.is_file() and not p.name.startswith("."))
    manifest = {**json_files.read(run / "manifest.json", {}), **changes, "updated": _now(), "files": files}
    json_files.write(run / "manifest.json", manifest)


def read_similarity(run: str | Path) -> Similarity:
    """To the coordinates of a run's checkpoints from those of its other files; none in runs that knew no other."""
    file = Path(run) / "manifest.json"
    record = json_files.read(file, {}).get("similarity") if file.exists() else None
    return IDENTITY if record is None else parse_similarity(record, file)


def save_checkpoint(run: str | Path, step: int, tree: Any) -> Path:
    """Writes `checkpoints/step_0001234.npz` and drops all but the newest two."""
    path = Path(run) / "checkpoints" / f"step_{step:07d}.npz"
    checkpoints.save(path, tree)
    for _, old in _checkpoints(run)[:-KEPT_CHECKPOINTS]:
        old.unlink(missing_ok=True)
    return path


def latest_checkpoint(run: str | Path, until: int | None = None) -> tuple[int, Path] | None:
    """Step and path of the newest checkpoint (after at most `until` steps), or None before the first."""
    candidates = [(step, path) for step, path in _checkpoints(run) if until is None or step <= until]
    return candidates[-1] if candidates else None


def append_metrics(run: str | Path, record: Mapping[str, Any]) -> None:
    """Adds one line to `metrics.jsonl`, with at least `step`; InputError of a disk that is full or read-only."""
    path = Path(run) / "metrics.jsonl"
    line = json.dumps(json_files.plain(record), allow_nan=False) + "\n"
    try:
        with open(path, "a", encoding="utf-8") as file:
            file.write(line)  # One write of one line: a killed run leaves at most the last line torn.
    except OSError as error:
        raise unwritable(path, error) from error


def read_metrics(run: str | Path) -> list[dict[str, Any]]:
    """All whole lines of `metrics.jsonl`, without a last one that a kill has torn; InputError of no record."""
    path = Path(run) / "metrics.jsonl"
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True) if path.exists() else []
    whole = [(f"{path}, line {i}", line) for i, line in enumerate(lines, 1) if line.endswith("\n")]
    return [json_files.parse(place, line, RECORD) for place, line in whole]


def truncate_metrics(run: str | Path, step: int) -> None:
    """Drops what was logged after `step`: a resumed run logs it again."""
    records = [record for record in read_metrics(run) if record["step"] <= step]
    with atomic_path(Path(run) / "metrics.jsonl") as temporary:
        temporary.write_text("".join(json.dumps(record) + "\n" for record in records), encoding="utf-8")


def read_settings(run: str | Path) -> dict[str, Any]:
    """What `config.json` holds, and for a run of an earlier version what it did where there was no choice."""
    file = Path(run) / "config.json"
    settings = config.merge(EARLIER, group_flat(json_files.read(file, {})))
    check(file, settings, SETTINGS)
    return settings


def _checkpoints(run: str | Path) -> list[tuple[int, Path]]:
    named = ((re.fullmatch(r"step_(\d+)\.npz", p.name), p) for p in (Path(run) / "checkpoints").glob("step_*.npz"))
    return sorted((int(match[1]), path) for match, path in named if match)


def _differences(before: Any, now: Any, at: str = "") -> dict[str, tuple[str, str]]:
    """Dotted keys at which two nested dicts differ, with both values as JSON."""
    if isinstance(before, dict) and isinstance(now, dict):
        differences = {}
        for key in [*before, *(key for key in now if key not in before)]:
            differences |= _differences(before.get(key), now.get(key), f"{at}.{key}" if at else key)
        return differences
    return {} if before == now else {at: (json.dumps(before), json.dumps(now))}


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
