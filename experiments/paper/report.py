"""The paper's three tables, with what was measured below what was published, as Markdown."""

from collections.abc import Sequence
from typing import NamedTuple

from paper import published
from paper.measured import METRICS, Average, RunScore, Value, average
from paper.published import PUBLISHED, notes_of, source
from paper.scenes import BLENDING, INDOOR, OUTDOOR, TANKS, parts

TABLES = {
    "Mip-NeRF 360": (INDOOR, OUTDOOR),
    "Tanks & Temples": (TANKS,),
    "Deep Blending": (BLENDING,),
}
DASH = "-"
DECIMALS = {"psnr": 2, "ssim": 3, "lpips": 3, "squeeze": 3}
HEADINGS = {"psnr": "PSNR", "ssim": "SSIM", "lpips": "LPIPS", "squeeze": "LPIPS, SqueezeNet"}


class Row(NamedTuple):
    """One line of a table."""

    method: str
    values: dict[str, Value | None]  # by metric
    scenes: str
    seeds: str
    source: str
    notes: tuple[str, ...] = ()


class Block(NamedTuple):
    """Rows under one heading: the published and measured averages of a part, or the measured figures of a scene."""

    title: str
    rows: list[Row]


class Table(NamedTuple):
    """One table of the paper."""

    title: str
    averages: list[Block]
    scenes: list[Block]


def tables(measured: Sequence[RunScore], methods: Sequence[str], remarks: dict[str, str] | None = None) -> list[Table]:
    """The three tables.

    Args:
        measured: All scores there are.
        methods: Names of the measured rows; one without scores has dashes.
        remarks: What there is to say about a scene's runs, by the scene's name.
    """
    remarks = remarks or {}
    return [
        Table(
            title,
            [Block(part, _published(part) + _averages(measured, methods, parts()[part], remarks)) for part in own],
            [
                Block(scene, _averages(measured, methods, [scene], remarks))
                for part in own
                for scene in parts()[part]
            ],
        )
        for title, own in TABLES.items()
    ]  # fmt: skip


def _published(part: str) -> list[Row]:
    count = str(len(parts()[part]))
    return [
        Row(
            method,
            dict.fromkeys(METRICS)
            | {m: Value(number, None) for m, number in zip(published.METRICS, numbers, strict=True)},
            count,
            DASH,
            source(part, method),
            tuple(notes_of(part, method)),
        )
        for method, numbers in PUBLISHED[part].items()
    ]


def _averages(
    measured: Sequence[RunScore], methods: Sequence[str], scenes: Sequence[str], remarks: dict[str, str]
) -> list[Row]:
    return [_measured_row(method, average(measured, method, scenes), scenes, remarks) for method in methods]


def _measured_row(method: str, scores: Average, scenes: Sequence[str], remarks: dict[str, str]) -> Row:
    named = f" ({', '.join(scores.scenes)})" if 0 < len(scores.scenes) < len(scenes) else ""
    over = str(len(scenes)) if len(scores.scenes) == len(scenes) else f"{len(scores.scenes)} of {len(scenes)}{named}"
    fewest, most = scores.seeds
    seeds = DASH if not most else str(most) if fewest == most else f"{fewest} to {most}"
    notes = tuple(remarks[scene] for scene in scores.scenes if scene in remarks)
    return Row(method, scores.values, over, seeds, "measured" if scores.scenes else DASH, notes)


def format_cell(value: Value | None, metric: str) -> str:
    """A mean with its spread where it has one; a dash for None."""
    if value is None:
        return DASH
    digits = DECIMALS[metric]
    spread = "" if value.spread is None else f" ± {value.spread:.{digits}f}"
    return f"{value.mean:.{digits}f}{spread}"


class _Notes:
    """Numbers notes in the order in which they are met; the same text keeps its number."""

    def __init__(self):
        self.texts: list[str] = []

    def marks(self, row: Row) -> str:
        for text in row.notes:
            if text not in self.texts:
                self.texts.append(text)
        return ",".join(str(self.texts.index(text) + 1) for text in row.notes)


COLUMNS = ("Method", *HEADINGS.values(), "Scenes", "Seeds", "Source")


def markdown(paper_tables: Sequence[Table]) -> str:
    """All tables, each with its notes below."""
    return "\n".join(_markdown_table(table) for table in paper_tables)


def _markdown_table(table: Table) -> str:
    notes, lines = _Notes(), [f"## {table.title}", ""]
    for block in [*table.averages, *table.scenes]:
        lines += [f"### {block.title}", "", _piped(COLUMNS), _piped(["---"] * len(COLUMNS))]
        for row in block.rows:
            marks = notes.marks(row)
            method = row.method + (f" [{marks}]" if marks else "")
            cells = [format_cell(row.values[metric], metric) for metric in METRICS]
            lines.append(_piped([method, *cells, row.scenes, row.seeds, row.source]))
        lines.append("")
    lines += [f"[{number}] {text}  " for number, text in enumerate(notes.texts, 1)]
    return "\n".join([*lines, ""])


def _piped(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"
