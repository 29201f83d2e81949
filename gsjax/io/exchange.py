"""Several files of a folder that change together: all of them are the old ones, or all the new ones."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gsjax.io.files import flush, put_in_place, unwritable, workspace

PENDING = ".pending"  # in the folder: whole new files, which are to take the place of the old ones


@contextmanager
def exchanged(folder: Path) -> Iterator[Path]:
    """An empty folder for new files of `folder`, which take the place of those of the same names after the block.

    Where the block fails, or is killed, nothing has changed. Killed later, what is missing is made up for by the next
    `refine_on_photos`, which all do that read the folder.

    Raises:
        InputError: The disk is full, read-only, or the like.
    """
    refine_on_photos(folder)
    with workspace(folder / PENDING) as made:
        yield made
        for file in made.iterdir():
            flush(file)
        put_in_place(made, folder / PENDING)
    refine_on_photos(folder)


def refine_on_photos(folder: Path) -> None:
    """Puts the files in place that an exchange has left pending when it was killed.

    Raises:
        InputError: They cannot be put there.
    """
    pending = folder / PENDING
    if not pending.is_dir():
        return
    try:
        with suppress(FileNotFoundError):  # Another process does the same.
            for file in sorted(pending.iterdir()):
                with suppress(FileNotFoundError):
                    os.replace(file, folder / file.name)
            flush(folder)
            pending.rmdir()
    except OSError as error:
        raise unwritable(folder, error) from error
