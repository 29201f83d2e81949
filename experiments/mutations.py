"""Which faults would the tests let pass? Plants them one at a time and runs the tests nearest to each.

    python experiments/mutations.py --out DIR [PATH ...] [--count N] [--seed S] [--minutes M] [--again]

A seeded sample of the faults that `faults.py` knows in some rooms or files, in a copy of the checkout. Prints the share
that some test noticed, by room, and what nobody did. Every outcome is a line of DIR/journal.jsonl: called again it goes
on, with --minutes it begins none after them. --again tries once more what nobody noticed, with the tests of today.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from faults import Fault, faults_of, planted

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("rasterizer", "gsjax/training", "gsjax/normals", "gsjax/measures", "gsjax/binding")
COPIED = ("gsjax", "rasterizer", "tests", "experiments", "pyproject.toml")
CONSTANTS = "experiments/test_paper_constants"
NEAREST: dict[str, tuple[str, ...]] = {
    "rasterizer/_native/calls": ("rasterizer/test_native_calls",),
    "rasterizer/_native/engine": ("rasterizer/test_native_calls", "rasterizer/test_native"),
    "rasterizer/_native": ("rasterizer/test_native",),
    "rasterizer/_reference": ("rasterizer/test_backends", "rasterizer/test_gradients"),
    "rasterizer/_xla": ("rasterizer/test_backends", "rasterizer/test_gradients"),
    "rasterizer/api": ("rasterizer/test_gsplat_arguments", "rasterizer/test_outputs"),
    "rasterizer/blending": ("rasterizer/test_backends", "rasterizer/test_outputs"),
    "rasterizer/checks": ("rasterizer/test_gsplat_arguments", "rasterizer/test_stages"),
    "rasterizer/compositing": ("rasterizer/test_outputs", "rasterizer/test_properties", "rasterizer/test_backends"),
    "rasterizer/covariances": ("rasterizer/test_projection", "rasterizer/test_stages"),
    "rasterizer/engines": ("rasterizer/test_devices", "rasterizer/test_backends"),
    "rasterizer/features": ("rasterizer/test_outputs", "rasterizer/test_plane_depth"),
    "rasterizer/normals": ("rasterizer/test_outputs",),
    "rasterizer/refusals": ("rasterizer/test_stages", "rasterizer/test_gsplat_arguments"),
    "rasterizer/reverse_mode": ("rasterizer/test_any_order", "rasterizer/test_gradients"),
    "rasterizer/rules": ("rasterizer/test_properties", CONSTANTS),
    "gsjax/normals/fitted_depth": ("gsjax/networks/test_depth_normals",),
    "gsjax/normals/sparse_depth": ("gsjax/normals/test_agreement",),
    "gsjax/training/capacity": ("gsjax/training/test_step",),
    "gsjax/training/growth/adaptive": ("gsjax/training/growth/test_adaptive", CONSTANTS),
    "gsjax/training/growth/rules": ("gsjax/training/test_loop",),
    "gsjax/training/initialize": ("gsjax/training/test_initialize", CONSTANTS),
    "gsjax/training/loop": ("gsjax/training/test_loop", "experiments/terms/test_surroundings"),
    "gsjax/training/optimizers": ("gsjax/training/test_optimizers", CONSTANTS),
    "gsjax/training/sharded": ("gsjax/training/sharded/test_placement", "test_several_devices"),
    "gsjax/training/state": ("gsjax/training/test_step",),
    "gsjax/training/stepping": ("gsjax/training/test_loop",),
    "gsjax/training/terms": ("gsjax/training/terms/test_losses", "gsjax/training/test_plan"),
    "gsjax/binding/editing": ("gsjax/binding/test_bound",),
}
"""Tests of files, and of folders, whose own test file has not their name."""


class Outcome(NamedTuple):
    """What became of a fault."""

    is_caught: bool
    by: str  # the test that failed, "time" where they took too long to tell, or nothing
    seconds: float


def nearest(file: str) -> tuple[str, ...]:
    """The test files run for a source file: those of `NEAREST`, else the one with its name, else all of its folder."""
    stem = file.removesuffix(".py")
    folder, _, name = stem.rpartition("/")
    own = f"{folder}/test_{name.lstrip('_')}"
    found = NEAREST.get(stem) or ((own,) if (ROOT / f"tests/{own}.py").is_file() else NEAREST.get(folder))
    if found:
        return tuple(f"tests/{test}.py" for test in found)
    return tuple(sorted(str(test.relative_to(ROOT)) for test in (ROOT / "tests" / folder).glob("test_*.py")))


def sample(within: Sequence[str], count: int, seed: int) -> list[Fault]:
    """Faults of files and folders, each as likely; of a larger sample with the same seed they are the first."""
    paths = [ROOT / name for name in within if name.endswith(".py")]
    paths += [path for name in within for path in (ROOT / name).rglob("*.py")]
    files = sorted({str(path.relative_to(ROOT)) for path in paths})
    every = [fault for file in files if nearest(file) for fault in faults_of(ROOT, file)]
    random.Random(seed).shuffle(every)
    return every[:count]


def copy_checkout(out: Path) -> Path:
    """OUT/checkout as the checkout is, with what lies beside it."""
    checkout = out / "checkout"
    shutil.rmtree(checkout, ignore_errors=True)
    for name in COPIED:
        source, target = ROOT / name, checkout / name
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(source, target)
    shared = ROOT.parent / "shared"
    if shared.is_dir() and not (out / "shared").exists():
        (out / "shared").symlink_to(shared.resolve())
    return checkout


def run_tests(checkout: Path, tests: Sequence[str], limit: float) -> Outcome:
    """Runs test files, or one test, until a test fails; `limit` in seconds."""
    cache = checkout.parent / "cache"
    here = {"PYTHONPATH": checkout, "PYTHONDONTWRITEBYTECODE": 1, "XDG_CACHE_HOME": cache}
    here |= {"JAX_COMPILATION_CACHE_DIR": cache / "programs", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": 0.1}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider", *tests]
    begun = time.monotonic()
    process = subprocess.Popen(
        command,
        cwd=checkout,
        env={**os.environ, **{name: str(value) for name, value in here.items()}},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        text, by = process.communicate(timeout=limit)[0], ""
    except subprocess.TimeoutExpired:
        text, by = "", "time"
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    failed = [line.split(" ", 1)[1] for line in text.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    by = by or (failed[0].split(" - ")[0] if failed else "its import" if process.returncode else "")
    return Outcome(by not in ("", "time"), by, time.monotonic() - begun)


class Journal:
    """What is known, a JSON line each; of one fault the last counts, the first is how it was before."""

    def __init__(self, file: Path):
        """Reads what there is."""
        self.file = file
        self.outcomes: dict[Fault, list[Outcome]] = {}
        for line in file.read_text().splitlines() if file.exists() else ():
            fault, outcome = json.loads(line)
            self.outcomes.setdefault(Fault(*fault), []).append(Outcome(*outcome))

    def note(self, fault: Fault, outcome: Outcome) -> None:
        """Keeps what became of a fault."""
        with self.file.open("a") as file:
            file.write(json.dumps([fault, outcome]) + "\n")
        self.outcomes.setdefault(fault, []).append(outcome)


def try_all(faults: Sequence[Fault], journal: Journal, checkout: Path, until: float, limit: float) -> None:
    """Plants the faults one after another, as long as there is time.

    A test that fails is run once more without the fault: if it fails then too, nothing can be told.
    """
    for number, fault in enumerate(faults, 1):
        if time.monotonic() > until:
            return
        file = checkout / fault.file
        file.write_bytes(planted(ROOT, fault))
        outcome = run_tests(checkout, nearest(fault.file), limit)
        shutil.copy2(ROOT / fault.file, file)
        if outcome.is_caught:
            again = [outcome.by] if "::" in outcome.by else ["--collect-only", *nearest(fault.file)]
            if run_tests(checkout, again, limit).by:
                raise SystemExit(f"{outcome.by} fails without any fault too")
        journal.note(fault, outcome)
        print(f"{number}/{len(faults)} {fault}: {outcome.by or 'NOBODY'}", file=sys.stderr, flush=True)


def table(faults: Sequence[Fault], journal: Journal) -> str:
    """Shares by room as Markdown, before and after tests were added, and the faults that nobody noticed."""
    known = {fault: journal.outcomes[fault] for fault in faults if fault in journal.outcomes}
    lines = ["| Room | Faults | Caught at first | Caught now |", "|---|---|---|---|"]
    for room in (*ROOMS, ""):
        own = [outcomes for fault, outcomes in known.items() if fault.file.startswith(room)]
        if own:
            counts = [sum(outcomes[turn].is_caught for outcomes in own) for turn in (0, -1)]
            shares = [f"{count} ({count / len(own):.0%})" for count in counts]
            lines.append(f"| {f'`{room}/`' if room else 'all'} | {len(own)} | {' | '.join(shares)} |")
    missed = [f"- {fault}" for fault, outcomes in known.items() if not outcomes[-1].is_caught]
    return "\n".join([*lines, "", f"{len(missed)} of {len(known)} that nobody noticed:", "", *missed])


def main() -> None:
    """Reads the arguments, plants, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("paths", metavar="PATH", nargs="*", default=ROOMS, help=f"folder or file; default: {' '.join(ROOMS)}")
    add("--out", type=Path, required=True, help="folder to work in")
    add("--count", type=int, default=60, help="how many faults (default: 60)")
    add("--seed", type=int, default=0, help="of the sample (default: 0)")
    add("--minutes", type=float, default=float("inf"), help="plant none after so many")
    add("--limit", type=float, default=600, help="seconds for the tests of a fault (default: 600)")
    add("--again", action="store_true", help="try once more what nobody noticed")
    given = parser.parse_args()
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    journal, faults = Journal(out / "journal.jsonl"), sample(given.paths, given.count, given.seed)
    if given.again:
        wanted = [f for f in faults if f in journal.outcomes and not journal.outcomes[f][-1].is_caught]
    else:
        wanted = [f for f in faults if f not in journal.outcomes]
    if wanted:
        try_all(wanted, journal, copy_checkout(out), time.monotonic() + 60 * given.minutes, given.limit)
    print(table(faults, journal))


if __name__ == "__main__":
    main()
