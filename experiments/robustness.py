"""Does anything break it? Stops, full disks, damaged files, other worlds, large files: each tried and counted.

    python experiments/robustness.py --out DIR [PART ...] [--only WORD ...]

Commands run on built-in scenes of a few photos. They are stopped at random moments by SIGKILL, SIGTERM and SIGINT and
called again; their disk is full before they are done; readers meet damaged files, those of their own tests. Prints the
tables of docs/robustness.md. Called again it continues after what is done; with --only it measures rows with one of the
words in their names.
Disks need Linux and its user namespaces. All parts take an hour or more on 2 cores.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from breaking import PARTS, Part


def measured(part: Part, file: Path, folder: Path, only: Sequence[str] = ("",)) -> dict[str, list[str]]:
    """The whole rows of a part: those of a file, and what is measured now, which the file keeps.

    Only rows are measured that have one of the words `only` in their names.
    """
    record: dict[str, list[list[str]]] = json.loads(file.read_text()) if file.exists() else {}
    rows = part.rows(folder)
    for name, measurements in rows.items():
        done = record.setdefault(name, [])
        is_selected = any(word in name for word in only)
        for measure in measurements[len(done) :] if is_selected else ():
            done.append(measure())
            file.write_text(json.dumps(record, indent=1))
            print(f"{name}: {', '.join(done[-1])}", file=sys.stderr)
    return {name: sum(record[name], []) for name in rows if len(record[name]) == len(rows[name])}


def table(part: Part, rows: dict[str, list[str]]) -> str:
    """As Markdown."""
    lines = [part.columns, ["---"] * len(part.columns), *([name, *cells] for name, cells in rows.items())]
    return f"## {part.title}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main() -> None:
    """Reads the arguments, measures and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", metavar="PART", nargs="*", help=f"of {', '.join(PARTS)}; all where none is named")
    parser.add_argument("--out", type=Path, required=True, help="folder to work in")
    parser.add_argument("--only", metavar="WORD", nargs="+", default=[""], help="measure rows with a word in the name")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.parts if name not in PARTS]
    if unknown:
        parser.error(f"no part {unknown[0]}; there are {', '.join(PARTS)}")
    folder = arguments.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for name in arguments.parts or PARTS:
        rows = measured(PARTS[name], folder / f"{name}.json", folder, arguments.only)
        print(table(PARTS[name], rows), flush=True)


if __name__ == "__main__":
    main()
