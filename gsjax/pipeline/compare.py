"""Several runs on one page: what differs between them, what they scored, and their curves; seeds are pooled."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from gsjax.errors import InputError
from gsjax.report import facts as run_facts
from gsjax.report import tables
from gsjax.report.facts import RunFacts, flat_settings
from gsjax.report.page import write_page
from gsjax.runs.outputs import require_apart

SEEDS = ("seed", "refinement.seed")
CHARTS = {
    "PSNR of held-out views, dB": {"": "held_out_psnr"},
    "PSNR of training views, dB": {"": "psnr"},
    "Loss": {"": "loss"},
    "Gaussians": {"": "gaussians"},
}
MEASURED = ("psnr", "ssim", "gaussians", "faces", "steps", "train_seconds", "peak_gib")


def compare(folders: Iterable[str | Path], out: str | Path) -> Path:
    """Write a page that sets runs side by side. Runs of one scene that differ by their seed alone are one row.

    Args:
        folders: Run folders, at least two; they need not be finished.
        out: The .html file.

    Returns:
        `out`.

    Raises:
        InputError: A folder is no run or its files are damaged, one is named twice, the file is no .html, or it cannot
            be written.
    """
    folders, out = [Path(folder) for folder in folders], Path(out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: the comparison is a page, its name ends in .html")
    if len(folders) < 2:
        raise InputError(f"there is nothing to compare {' '.join(map(str, folders))} with")
    require_apart(out, *folders)
    resolved = [folder.resolve() for folder in folders]
    for folder in folders:
        if resolved.count(folder.resolve()) > 1:
            raise InputError(f"{folder}: is named twice")
    pools = pooled_by_seed([RunFacts.open(folder) for folder in folders])
    return write_page(
        out,
        "compare.html",
        name=out.stem,
        pools=pools,
        differences=differences(pools),
        scores=scores(pools),
        members=[(label, *_member(run)) for label, pool in pools.items() for run in pool],
        charts={axis: run_facts.charts(pools, axis, CHARTS) for axis in run_facts.AXES},
    )


def pooled_by_seed(facts: Sequence[RunFacts]) -> dict[str, list[RunFacts]]:
    """Runs by a label: those of one data set whose settings are the same but for the seed are together.

    The label is the first run's folder; with as much of its path as differs from the others'.
    """
    pools: dict[tuple, list[RunFacts]] = {}
    for run in facts:
        settings = {key: value for key, value in flat_settings(run.settings).items() if key not in SEEDS}
        pools.setdefault((run.manifest["scene"], *sorted(settings.items())), []).append(run)
    labels = _short_names([pool[0].folder for pool in pools.values()])
    return dict(zip(labels, pools.values(), strict=True))


def differences(pools: Mapping[str, Sequence[RunFacts]]) -> dict[str, list[str]]:
    """Data set and settings, seeds apart, that are not the same in all pools: name -> the value in each of them."""
    # What the others of a pool have too.
    first = [{"data set": pool[0].manifest["scene"], **flat_settings(pool[0].settings)} for pool in pools.values()]
    names = [name for name in dict.fromkeys(name for each in first for name in each) if name not in SEEDS]
    values = {name: [each.get(name, "-") for each in first] for name in names}
    return {name: row for name, row in values.items() if len(set(row)) > 1}


def scores(pools: Mapping[str, Sequence[RunFacts]]) -> dict[str, list[str]]:
    """Quantity -> in each pool its value, of seeds that differ the mean, least, most; a dash where a run lacks it."""

    def text_of(pool: Sequence[RunFacts], name: str) -> str:
        values = [run.manifest.get(name) for run in pool]
        if None in values:
            return "-"
        mean, least, most = (tables.format_value(of(values)) for of in (fmean, min, max))
        return mean if least == most else f"{mean} [{least} {most}]"

    table: dict[str, Any] = {name: [text_of(pool, name) for pool in pools.values()] for name in MEASURED}
    return {name: row for name, row in table.items() if set(row) != {"-"}}


def _member(run: RunFacts) -> tuple[str, ...]:
    """Folder, seed, state, machine and commit."""
    manifest = run.manifest
    machine = manifest["machine"].get("accelerator") or manifest["machine"]["cpu"]
    seed = run.settings.get("refinement", run.settings)["seed"]
    return str(run.folder), str(seed), run_facts.state(run), machine, manifest["versions"].get("commit", "-")


def _short_names(folders: Sequence[Path]) -> list[str]:
    """The shortest ends of the paths that are all different."""
    parts = [folder.resolve().parts for folder in folders]
    ends = (["/".join(each[-length:]) for each in parts] for length in range(1, max(map(len, parts)) + 1))
    return next(names for names in ends if len(set(names)) == len(names))
