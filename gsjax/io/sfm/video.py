"""The sharpest frame of every stretch of a video."""

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.color_profiles import HDR, code_points
from gsjax.io.files import atomic_path, make_folder
from gsjax.io.images import cv2
from gsjax.io.messages import print_once

_SHARPNESS_SIDE = 640  # pixels of the longer side: sharpness of the lens, without the noise of single pixels
_JPEG_QUALITY = 95
_HEAD = 2**20  # bytes of a file of Matroska that hold its description
_MATROSKA = b"\x1a\x45\xdf\xa3"
_TRANSFER = re.compile(rb"\x55\xba\x81(.)", re.DOTALL)  # Matroska's TransferCharacteristics, one byte


def write_sharpest_frames(video: Path, folder: Path, count: int, progress: Callable[..., tqdm]) -> Path:
    """Cut the video into `count` stretches of one length and write the sharpest frame of each.

    Frames are turned by the video's rotation, and called NNNNNN.jpg by their number in the video, from 0; a shorter
    video gives all its frames. One pass; two frames in memory at a time. Returns the folder.

    Raises:
        InputError: The video cannot be read, or has fewer than two frames.
    """
    make_folder(folder)
    total = _frame_count(video)
    transfer = transfer_function(video)
    if transfer is not None:
        fault = f"{video}: is coded for high dynamic range ({transfer}), which is not converted"
        print_once(f"{fault}; its colours are taken as sRGB; export it in standard dynamic range for true colours")
    stretches = min(count, total)
    best, best_sharpness, best_index, stretch = None, -1.0, 0, 0
    with progress(total=total, desc="video", unit="frame") as bar:
        for index, frame in enumerate(_frames(video)):
            if index * stretches // total > stretch and stretch < stretches - 1:
                _write(folder, best_index, best)
                best_sharpness, stretch = -1.0, stretch + 1
            if (sharpness := _sharpness(frame)) > best_sharpness:
                best, best_sharpness, best_index = frame, sharpness, index
            bar.update(1)
    _write(folder, best_index, best)
    return folder


def transfer_function(video: Path) -> str | None:
    """Read PQ or HLG from the file of a video; None where it states another transfer function, or none.

    MP4 and MOV state it in a `colr` box, among their other tables and never in their pictures; Matroska and WebM in an
    element of their head. OpenCV does not report it.
    """
    with video.open("rb") as file:
        head = file.read(_HEAD)
        if head[: len(_MATROSKA)] == _MATROSKA:
            stated = _TRANSFER.search(head)
            return HDR.get(stated[1][0]) if stated else None
        coded = code_points(_tables(file))
    return None if coded is None else HDR.get(coded.transfer)


def _tables(file: BinaryIO) -> bytes:
    """Return the `moov` box of an MP4 or MOV; empty of other files."""
    end = file.seek(0, 2)
    at = 0
    while at + 8 <= end:
        file.seek(at)
        size, kind = struct.unpack(">I4s", file.read(8))
        header = 8
        if size == 1 and at + 16 <= end:  # a size of 64 bits follows
            (size,), header = struct.unpack(">Q", file.read(8)), 16
        elif size == 0:  # to the end
            size = end - at
        if size < header:
            break
        if kind == b"moov":
            return file.read(size - header)
        at += size
    return b""


def _frame_count(video: Path) -> int:
    """Return the number of frames that the file states, or else the counted ones."""
    capture = _open(video)
    stated = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    count = 0
    while count < (2 if stated > 0 else np.inf) and capture.grab():
        count += 1
    capture.release()
    if count < 2:
        raise InputError(f"{video}: needs at least 2 frames, has {count}")
    return max(count, stated)


def _frames(video: Path):
    capture = _open(video)
    while (read := capture.read())[0]:
        yield read[1]
    capture.release()


def _open(video: Path):
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise InputError(f"{video}: not a video that can be read")
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
    return capture


def _sharpness(frame: np.ndarray) -> float:
    """Return the variance of the Laplacian of the reduced picture."""
    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    scale = _SHARPNESS_SIDE / max(grey.shape)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def _write(folder: Path, index: int, frame: np.ndarray) -> None:
    _, encoded = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    with atomic_path(folder / f"{index:06d}.jpg") as temporary:  # OpenCV's own writer does not report full disks.
        temporary.write_bytes(encoded)
