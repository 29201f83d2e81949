"""What does accuracy cost in time? Every setting that trades one for the other, in one table and one picture.

    python experiments/accuracy_vs_time.py --scene SCENE --out DIR [--config NAME] [--settings NAME ...]
        [--rounds N] [--share S]

SCENE is a data set, such as the built-in one of `gsjax demo`. In every round every value of a setting is run once, in
turn. The time of a value is a multiple of that of the most accurate value in the same round; its errors are the
differences from the scores of that value. The most accurate value is run twice a round: the difference of its two times
is that of the machine. Writes DIR/accuracy_vs_time.md and .png after every setting. Called again it resumes after the
last whole round.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from train import claim, load_settings

from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.io import json_files

AGAIN = "the same again"

Rounds = list[dict[str, dict[str, Any]]]
"""A round: label -> `seconds` and `errors` (by unit), the most accurate first, and `AGAIN`."""


def run(
    scene: str, out: str, names: Sequence[str], rounds: int, share: float, config: str = "built_in"
) -> dict[str, Rounds]:
    """Measures the rounds of the named settings (all where none is named) that are left; returns all by setting."""
    import settings_table

    from gsjax.config import to_dict

    whole = to_dict(load_settings(config))
    table = settings_table.table(whole)
    if unknown := [name for name in names if name not in table]:
        raise InputError(f"--settings: no setting {unknown[0]!r}; there are {', '.join(table)}")
    claim(Path(out), {"scene": str(Path(scene).resolve()), "config": config, "share": share})
    place, ledger = settings_table.Place(scene, out, whole, share), Path(out) / "rounds.json"
    done: dict[str, Rounds] = json_files.read(ledger) if ledger.exists() else {}
    for name in names or table:
        while len(done.setdefault(name, [])) < rounds:
            print(f"== {name}, round {len(done[name]) + 1} of {rounds}", flush=True)
            done[name].append(one_round(table[name], place, len(done[name])))
            json_files.write(ledger, done)
        write(Path(out), {setting: each for setting, each in done.items() if each})
    return done


def one_round(setting: Any, place: Any, index: int) -> dict[str, dict[str, Any]]:
    """Every value once and the most accurate twice, in an order that turns from round to round."""
    from settings_table import errors

    first = next(iter(setting.values))
    values = {**setting.values, AGAIN: setting.values[first]}
    labels = list(values)
    order = labels[index % len(labels) :] + labels[: index % len(labels)]
    measured = {label: setting.measure(place, values[label], index) for label in order}
    best = measured[first][1]
    return {label: {"seconds": measured[label][0], "errors": errors(measured[label][1], best)} for label in labels}


def ratios(rounds: Rounds, label: str) -> np.ndarray:
    """`[rounds]` times of a value as multiples of the most accurate one's."""
    first = next(iter(rounds[0]))
    return np.array([each[label]["seconds"] / each[first]["seconds"] for each in rounds])


def errors(rounds: Rounds, label: str, unit: str) -> np.ndarray:
    """`[rounds]` errors of a value."""
    return np.array([each[label]["errors"][unit] for each in rounds], float)


def on_front(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Which of some (time, error) no other beats in one without losing in the other."""
    return [
        not any((t <= time and e <= error) and (t < time or e < error) for t, e in points) for time, error in points
    ]


def table(done: Mapping[str, Rounds]) -> str:
    """One Markdown table: median and, in brackets, least and most over the rounds."""
    from gsjax.io.machine import machine, versions

    lines = ["| Setting | Value | Time | Errors | Front |", "|---|---|---|---|---|"]
    for name, rounds in done.items():
        labels, units = list(rounds[0]), list(next(iter(rounds[0].values()))["errors"])
        plain = [label for label in labels if label != AGAIN]
        points = [(np.median(ratios(rounds, x)), np.median(errors(rounds, x, units[0]))) for x in plain]
        front = dict(zip(plain, on_front(points), strict=True))
        for label in labels:
            every = "; ".join(f"{unit}: {_spread(errors(rounds, label, unit))}" for unit in units)
            mark = "yes" if front.get(label) else ""
            lines.append(f"| {name} | {label} | {_spread(ratios(rounds, label))} | {every} | {mark} |")
    about = {**machine(), **versions()}
    environment = ", ".join(f"{key} {about[key]}" for key in ("cpu", "cores", "jax", "commit") if about.get(key))
    most = max(len(rounds) for rounds in done.values())
    return "\n".join([*lines, "", f"Up to {most} rounds; seconds as ratios within a round; {environment}.", ""])


def _spread(values: np.ndarray) -> str:
    return f"{np.median(values):.3g} [{values.min():.3g} {values.max():.3g}]"


def write(out: Path, done: Mapping[str, Rounds]) -> None:
    """The table and the picture, replaced."""
    from gsjax.io.files import atomic_path

    with atomic_path(out / "accuracy_vs_time.md") as temporary:
        temporary.write_text(table(done))
    with atomic_path(out / "accuracy_vs_time.png") as temporary:
        draw(temporary, done)


def draw(file: Path, done: Mapping[str, Rounds]) -> None:
    """A panel a setting: first error against time, with the spread of both; the front is joined by a line."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    columns = min(4, len(done))
    rows = -(-len(done) // columns)
    figure, panels = pyplot.subplots(rows, columns, figsize=(3.6 * columns, 3.1 * rows), squeeze=False)
    for panel in panels.flat[len(done) :]:
        panel.axis("off")
    for panel, (name, rounds) in zip(panels.flat, done.items(), strict=False):
        unit = next(iter(next(iter(rounds[0].values()))["errors"]))
        labels = [label for label in rounds[0] if label != AGAIN]
        times = np.array([ratios(rounds, label) for label in labels])
        off = np.array([errors(rounds, label, unit) for label in labels])
        x, y = np.median(times, 1), np.median(off, 1)
        panel.axvspan(ratios(rounds, AGAIN).min(), ratios(rounds, AGAIN).max(), color="0.9", zorder=0)
        panel.errorbar(x, y, xerr=_arms(times, x), yerr=_arms(off, y), fmt="o", color="0.35", ms=4, lw=0.8, capsize=2)
        front = [i for i, is_on in enumerate(on_front(list(zip(x, y, strict=True)))) if is_on]
        front.sort(key=lambda i: x[i])
        panel.plot(x[front], y[front], "-", color="tab:red", lw=1.2, zorder=1)
        for turn, i in enumerate(np.lexsort((y, x))):
            # Above and below in turn: neighbours along the axis of time do not write over each other.
            beside = {"xytext": (4, 4)} if turn % 2 == 0 else {"xytext": (4, -4), "va": "top"}
            panel.annotate(labels[i], (x[i], y[i]), textcoords="offset points", fontsize=7, **beside)
        panel.set_title(name, fontsize=9)
        panel.set_xlabel("time, of the most accurate", fontsize=7)
        panel.set_ylabel(unit, fontsize=7)
        panel.tick_params(labelsize=7)
        panel.margins(0.18)
    figure.tight_layout()
    figure.savefig(file, dpi=110, format="png")
    pyplot.close(figure)


def _arms(values: np.ndarray, middle: np.ndarray) -> np.ndarray:
    return np.stack([middle - values.min(1), values.max(1) - middle])


def main() -> None:
    """Reads the arguments, measures, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for runs, table and picture")
    parser.add_argument(
        "--config", default="built_in", metavar="NAME", help="of configs.py, to vary (default: built_in)"
    )
    parser.add_argument("--settings", nargs="+", default=[], metavar="NAME", help="those to vary (default: all)")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="of every setting (default: 3)")
    parser.add_argument("--share", type=float, default=1.0, help="of the config's steps, in every run (default: 1)")
    arguments = parser.parse_args()
    options = arguments.settings, arguments.rounds, arguments.share, arguments.config
    print(table(run(arguments.scene, arguments.out, *options)))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
