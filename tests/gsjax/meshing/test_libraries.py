import builtins
import subprocess
import sys

import pytest

from gsjax.errors import InputError
from gsjax.meshing import libraries


@pytest.mark.parametrize(("name", "load"), [("open3d", libraries.load_open3d), ("trimesh", libraries.load_trimesh)])
def test_a_missing_package_is_one_line_with_the_remedy(monkeypatch, name, load):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=f"pip install {name}") as caught:
        load()
    assert "\n" not in str(caught.value)


def test_a_missing_system_library_is_one_line_with_the_remedy(monkeypatch):
    real_import = builtins.__import__

    def broken(name, *args, **kwargs):
        if name == "open3d":
            raise OSError("libusb-1.0.so.0: cannot open shared object file: No such file or directory")
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", broken)
    with pytest.raises(InputError, match=r"libusb-1\.0\.so\.0.*apt install libusb-1\.0-0"):
        libraries.load_open3d()


def test_importing_meshing_loads_neither():
    code = "import sys, gsjax.meshing; print('open3d' in sys.modules, 'trimesh' in sys.modules, 'cv2' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False", "False"]
