"""Which frames of `transforms.json` are for what, where the file itself says so.

nerfstudio lists names in `train_filenames`, `test_filenames` and `val_filenames`; ScanNet++ lists frames of their own
in `test_frames`, and marks bad ones by `is_bad`. Others say of each frame its `split`.
"""

import posixpath
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gsjax.errors import InputError
from gsjax.io.bad_items import leave_out, read_usable
from gsjax.io.messages import print_once

TRAINED_ON, HELD_OUT, LEFT_OUT = "trained on", "held out", "left out"
_TRAIN, _SCORE = "train_filenames", ("test_filenames", "val_filenames")
_TEST_FRAMES = "test_frames"
_SPLITS_OF_SCORES = {"test", "val", "validation", "eval"}


def frames_and_uses(file: Path, meta: dict[str, Any]) -> tuple[list[dict[str, Any]], list[str]]:
    """The entries of all frames, each with what the file says for all of them, and what each is for.

    Frames that a list for scoring names, or that say so themselves, are held out, whatever another list says. Where the
    file lists those to train on, the rest is held out, or left out if there is a list for scoring too. Bad frames are
    left out. A line on stderr counts those that are left out.

    Raises:
        InputError: A frame has no `file_path`, or a list names a photo that is in no frame.
    """
    shared = {key: value for key, value in meta.items() if key not in ("frames", _TEST_FRAMES)}
    tests = meta.get(_TEST_FRAMES) or []
    own = tests if isinstance(tests, list) and all(isinstance(frame, dict) for frame in tests) else []
    first_own = len(meta["frames"])
    listed = list(enumerate([*meta["frames"], *own]))
    frames, faults = read_usable(listed, lambda each: f"frame {each[0]}", partial(_named, file))
    leave_out("frames", faults, len(listed))
    numbers = [number for number, _ in frames]
    frames = [frame for _, frame in frames]
    names = [_normal(frame["file_path"]) for frame in frames]
    trained = _listed(file, meta, _TRAIN, names)
    scored = set().union(*(_listed(file, meta, key, names) for key in _SCORE))
    if not own:
        scored |= _listed(file, meta, _TEST_FRAMES, names)
    scored |= {
        name for name, frame in zip(names, frames, strict=True) if str(frame.get("split")).lower() in _SPLITS_OF_SCORES
    }

    def use(index: int) -> str:
        if _is_bad(frames[index]):
            return LEFT_OUT
        if numbers[index] >= first_own or names[index] in scored:
            return HELD_OUT
        if trained and names[index] not in trained:
            return LEFT_OUT if scored or own else HELD_OUT
        return TRAINED_ON

    uses = [use(index) for index in range(len(frames))]
    if LEFT_OUT in uses:
        bad = sum(map(_is_bad, frames))
        print_once(
            f"{file}: {bad} of its frames are left out as bad, {uses.count(LEFT_OUT) - bad} as being in no list of it"
        )
    return [{**shared, **frame} for frame in frames], uses


def _named(file: Path, numbered: tuple[int, Any]) -> tuple[int, dict[str, Any]]:
    number, frame = numbered
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise InputError(f'{file}: frame {number} has no "file_path"')
    return number, frame


def _is_bad(frame: dict[str, Any]) -> bool:
    """Whether a frame says so, as true, 1 or a word."""
    return str(frame.get("is_bad")).lower() in ("true", "1", "yes")


def _listed(file: Path, meta: dict[str, Any], key: str, names: Sequence[str]) -> set[str]:
    """The photos of a list, in the form of `names`."""
    value = meta.get(key)
    if value is None:
        return set()
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise InputError(f"{file}: {key} is no list of names")
    listed_names = {_normal(name): name for name in value}
    unknown = [listed_names[name] for name in sorted(listed_names.keys() - set(names))]
    if unknown:
        raise InputError(f"{file}: {key} lists {unknown[0]}, which is the file_path of no frame")
    return set(listed_names)


def _normal(name: str) -> str:
    return posixpath.normpath(name.replace("\\", "/"))
