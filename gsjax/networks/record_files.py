"""Records of networks, by the name that the command line was given: a known one, or a file of one's own."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from gsjax import config
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.networks.records import Network

N = TypeVar("N", bound=Network)


def read_record(
    network: str | Path, known: Mapping[str, N], kind_of: Callable[[Mapping[str, Any]], type[N]]
) -> tuple[str, N]:
    """A network's name and record.

    Args:
        network: A name of `known`, or a JSON file.
        known: The records that have a name.
        kind_of: What a file holds -> the kind of record that it is to be read as.

    Raises:
        InputError: It is neither a known name nor a file, or the file is no such record; names the key.
    """
    if str(network) in known:
        return str(network), known[str(network)]
    file = Path(network)
    if not file.is_file():
        names = ", ".join(known)
        raise InputError(f"--network {network}: neither a known network ({names}) nor a file that describes one")
    data = json_files.read(file)
    if not isinstance(data, Mapping):
        raise InputError(f"{file}: holds no table of keys that describes a network")
    return file.stem, config.parse(kind_of(data), data, where=str(file))
