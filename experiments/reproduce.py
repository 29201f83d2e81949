"""Do we reach the paper's tables? One run a scene, schedule and seed of its data sets, each in its own process.

    python experiments/reproduce.py --data ROOT --out DIR [--seeds N] [--preset NAME ...] [--set KEY=VALUE ...]

Runs what it finds under a root. A finished run is not done again, a stopped one continues, and one that fails leaves a
dash. Writes OUT/tables.md next to the runs, OUT/SCENE/SCHEDULE_SEED each.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from paper.scenes import DEFAULT_SCHEDULES, SCHEDULES, R, discover
from paper.tables import markdown, measurements, methods, run_folder, run_results
from paper_run import is_finished, read_result, run_settings

from gsjax.cli import parsers, run_guarded
from gsjax.errors import InputError


class Job(NamedTuple):
    """One run that is wanted."""

    scene: str
    data: Path
    out: Path
    schedule: str
    seed: int

    def __str__(self):
        return f"{self.scene}, {self.schedule}, seed {self.seed}"


class Options(NamedTuple):
    """What all runs share, as on the command line."""

    assignments: Sequence[str] = ()
    refinement: Sequence[str] = ()
    lpips: Sequence[str] = ()


Start = Callable[[Job, Options], int]
"""Does one run and returns its exit code."""


def reproduce(
    root: Path,
    out: Path,
    *,
    schedules: Sequence[str] = DEFAULT_SCHEDULES,
    seeds: int = 1,
    options: Options,
    start: Start | None = None,
) -> list[Job]:
    """Do what is left to do of all runs, then write the tables.

    Args:
        root: Folder of the published data sets.
        out: Folder for the runs and the tables.
        schedules: Names of `SCHEDULES`.
        seeds: Runs of every scene and schedule, with seeds 0, 1, ...
        options: What all runs share.
        start: Does one run. None: in a process of its own.

    Returns:
        The runs that failed.

    Raises:
        InputError: Nothing of the paper is under `root`, an option is wrong, or a run was begun with others.
    """
    folders, faults = discover(root)
    for fault in faults:
        print(f"reproduce: {fault}", file=sys.stderr)
    jobs = [
        Job(scene, data, run_folder(out, scene, schedule, seed), schedule, seed)
        for seed in range(seeds)
        for scene, data in folders.items()
        for schedule in SCHEDULES
        if schedule in schedules
    ]
    waiting = [job for job in jobs if not _is_done(job, options)]  # Wrong options are an error before the first run.
    print(f"reproduce: {len(jobs)} runs of {', '.join(folders)}; {len(jobs) - len(waiting)} are done", file=sys.stderr)
    failed = []
    for job in waiting:
        code = (start or in_own_process)(job, options)
        if code:
            failed.append(job)
            print(f"reproduce: {job}: failed (exit code {code})", file=sys.stderr)
        write_tables(out, schedules)  # After every run: they are days.
    write_tables(out, schedules)
    return failed


def in_own_process(job: Job, options: Options) -> int:
    """Does one run by `paper_run.py`; what ends this process ends that one."""
    command = [sys.executable, str(Path(__file__).with_name("paper_run.py")), job.scene, str(job.data), str(job.out)]
    command += ["--schedule", job.schedule, "--seed", str(job.seed)]
    command += ["--set", *options.assignments] if options.assignments else []
    command += ["--refine", *options.refinement] if options.refinement else []
    command += [argument for file in options.lpips for argument in ("--lpips", str(file))]
    code = subprocess.run(command).returncode
    if code == 130:  # Interrupted by the user, who means all of it.
        raise KeyboardInterrupt
    return code


def _is_done(job: Job, options: Options) -> bool:
    wishes = run_settings(job.scene, job.schedule, job.seed, options.assignments, options.refinement)
    return is_finished(read_result(job.out, wishes, options.lpips))


def write_tables(out: Path, schedules: Iterable[str]) -> None:
    """OUT/tables.md of all runs in the folder; the requested schedules have rows even without any."""
    from gsjax.io.files import atomic_path

    results = run_results(out)
    names = methods({*schedules, *(schedule for _, schedule, _, _ in results)})
    with atomic_path(Path(out) / "tables.md") as temporary:
        temporary.write_text(markdown(measurements(results), names, remarks(results)), encoding="utf-8")


def remarks(results: Iterable[tuple[str, str, int, dict[str, Any]]]) -> dict[str, str]:
    """What a reader of a scene's figures must know: which normals, and whether densification was limited."""
    notes: dict[str, list[str]] = {}
    for scene, schedule, seed, result in results:
        lines, trained = notes.setdefault(scene, []), result.get("train", {})
        if SCHEDULES[schedule].regulariser == R and trained and trained.get("normals") is None:
            lines.append("R with the run's own smoothed normals, not with a network's (the paper: Omnidata)")
        if trained.get("cap_bound"):
            lines.append(f"{schedule}, seed {seed}: limited to {trained['max_gaussians']:,} Gaussians")
    return {scene: f"{scene}: {'; '.join(dict.fromkeys(lines))}." for scene, lines in notes.items() if lines}


def main() -> None:
    """Reads the arguments, runs, and says where the tables are."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--data", type=Path, required=True, metavar="ROOT", help="folder of the published data sets: scenes by their"
        " published names, in it or in 360_v2/, tandt/, db/")  # fmt: skip
    add("--out", type=Path, required=True, metavar="DIR", help="folder for runs and tables; unfinished ones continue")
    add("--seeds", type=parsers.count, default=1, metavar="N", help="runs of every scene and schedule (default: 1)")
    add("--preset", nargs="+", choices=SCHEDULES, default=list(DEFAULT_SCHEDULES), help="schedules (default: the"
        " paper's two); 3dgs_30k and sugar are the methods that it compares with; vanilla is the first without entropy,"
        " cull and R, whose meshes the sheets then show too")  # fmt: skip
    add("--set", nargs="+", default=[], metavar="KEY=VALUE", help="settings of the training by their dotted keys")
    add("--refine", nargs="+", default=[], metavar="KEY=VALUE", help="settings of the refinement")
    add("--lpips", action="append", default=[], metavar="FILE", help="weights of LPIPS, as for `gsjax eval`; may be"
        " repeated (default: LPIPS is a dash)")  # fmt: skip
    arguments = parser.parse_args()
    for file in arguments.lpips:
        if not Path(file).is_file():
            raise InputError(f"{file}: no such file of weights")
    options = Options(arguments.set, arguments.refine, arguments.lpips)
    failed = reproduce(
        arguments.data, arguments.out, schedules=arguments.preset, seeds=arguments.seeds, options=options
    )
    print(f"{arguments.out / 'tables.md'}")
    if failed:
        print(f"reproduce: {len(failed)} runs failed; the same command tries them again", file=sys.stderr)
        raise SystemExit(1)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
