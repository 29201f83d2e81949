"""The pieces that a run was handed in addition to its settings.

The manifest names them, and a resumed run needs them again.
"""

from collections.abc import Mapping
from typing import Any

from gsjax.errors import InputError
from gsjax.runs.run import Run

ENTRY = "handed_in"
"""Of the manifest: names of terms and effects, and whether there is a rule of densification."""


def pieces_record(terms: Mapping[str, Any], densification: Any, effects: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of the manifest; nothing where nothing is handed in."""
    record = {"terms": sorted(terms), "effects": sorted(effects), "densification": densification is not None}
    return {ENTRY: record} if any(record.values()) else {}


def require_pieces(run: Run, record: Mapping[str, Any]) -> None:
    """Refuse to resume a run with other pieces than it was started with.

    Args:
        run: The run.
        record: As `pieces_record` returns it.

    Raises:
        InputError: A piece is missing, or new.
    """
    started = run.manifest.get(ENTRY)
    if started != record.get(ENTRY):
        raise InputError(
            f"{run.folder}: was started with {_as_arguments(started)}, not with {_as_arguments(record.get(ENTRY))};"
            " a resumed run is handed the same"
        )


def _as_arguments(record: Mapping[str, Any] | None) -> str:
    """A record as arguments of `gsjax.train`."""
    if record is None:
        return "no terms=, effects= or densification="
    names = [f"{kind}={{{', '.join(record[kind])}}}" for kind in ("terms", "effects") if record[kind]]
    return ", ".join(names + ["densification="] * record["densification"])
