"""Open3D and trimesh, loaded where they are used, or one line that says what to install."""

import logging
from types import ModuleType

from gsjax.errors import InputError


def load_open3d() -> ModuleType:
    """The `open3d` package.

    Raises:
        InputError: It is not installed, or a system library that it needs is not there.
    """
    try:
        import open3d
    except ImportError as error:
        raise InputError(f"meshing needs Open3D, which does not import ({error}): pip install open3d") from error
    except OSError as error:
        raise InputError(
            f"Open3D lacks a system library ({error}): apt install libusb-1.0-0 libgl1 libgomp1 (Debian, Ubuntu)"
        ) from error
    return open3d


def load_trimesh() -> ModuleType:
    """The `trimesh` package, without its log: of a picture that is absent it would print a traceback.

    Raises:
        InputError: It is not installed.
    """
    try:
        import trimesh
    except ImportError as error:
        raise InputError(f"mesh files need trimesh, which does not import ({error}): pip install trimesh") from error
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    return trimesh
