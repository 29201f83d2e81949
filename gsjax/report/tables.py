"""Plain-text tables of results, aligned for a terminal."""

from collections.abc import Collection, Mapping
from typing import Any

FLOOR = "true mesh (floor)"
"""The row below which no distance to the truth can fall: what the true mesh itself scores."""


def record(values: Mapping[str, Any]) -> str:
    """Two columns, name and value; nested mappings get dotted names."""
    return align_columns([[name, format_value(value)] for name, value in flatten(values)])


def compare(variants: Mapping[str, Mapping[str, Any]]) -> str:
    """One row per variant, one column per quantity that any of them has."""
    names = list(dict.fromkeys(name for values in variants.values() for name in values))
    rows = [[variant, *(format_value(values.get(name)) for name in names)] for variant, values in variants.items()]
    return align_columns([["", *names], *rows], right=range(1, len(names) + 1))


def align_columns(rows: list[list[str]], right: Collection[int] = ()) -> str:
    """Rows of cells in columns; those numbered in `right` end at one edge."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]

    def line(row: list[str]) -> str:
        cells = (c.rjust(w) if i in right else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        return "  ".join(cells).rstrip()

    return "\n".join(map(line, rows))


def flatten(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Pairs of name and value; nested mappings get dotted names."""
    pairs = []
    for name, value in values.items():
        pairs += flatten(value, f"{prefix}{name}.") if isinstance(value, Mapping) else [(f"{prefix}{name}", value)]
    return pairs


def format_value(value: Any) -> str:
    """A value as tables show it: four digits, thousands apart, a dash for None."""
    if value is None:
        return "-"
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int) or (isinstance(value, float) and abs(value) >= 1000):
        return f"{value:,.0f}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
