"""Libraries that are missing or broken, and what `gsjax --version` and `gsjax doctor` say of an installation."""

import json
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from unittest.mock import Mock

import pytest

from gsjax import cli
from gsjax.io import installation
from gsjax.io.installation import Finding, check_libraries
from gsjax.io.packages import EXTRAS, MissingPackageError, require

PROJECT = tomllib.loads((Path(__file__).resolve().parents[3] / "pyproject.toml").read_text())["project"]
pytestmark = pytest.mark.usefixtures("own_environment")


@pytest.fixture
def needs(monkeypatch):
    """Stands in for what gsjax needs."""

    def set_to(*lines):
        monkeypatch.setattr(installation, "requirements", lambda: list(lines))
        return {finding.name: finding for finding in check_libraries()}

    return set_to


def test_the_version_is_told_without_loading_jax(capsys, monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    monkeypatch.setitem(sys.modules, "jax", None)  # Whoever imports it now fails.
    assert cli.main(["--version"]) == 0
    expected = f"gsjax {PROJECT['version']}, jax {metadata.version('jax')}, native rasterizer on the CPU\n"
    assert capsys.readouterr().out == expected


def test_bounds_are_those_of_the_project():
    for module, extra in EXTRAS.items():
        (name,) = {package for package, other in installation.MODULES.items() if other == module} or {module}
        lines = PROJECT["optional-dependencies"][extra]
        assert any(re.match(rf"{name}\b", line) for line in lines), f"{name} is not in the extra {extra}"
    of_extras = [line for extra in set(EXTRAS.values()) for line in PROJECT["optional-dependencies"][extra]]
    assert set(installation.requirements()) == {line.replace(" ", "") for line in PROJECT["dependencies"] + of_extras}


def test_a_library_is_absent_or_too_old_or_does_not_load_or_is_fine(needs, tmp_path, monkeypatch):
    (tmp_path / "broken_one-1.0.dist-info").mkdir()
    (tmp_path / "broken_one-1.0.dist-info/METADATA").write_text("Name: broken-one\nVersion: 1.0\n")
    (tmp_path / "broken-one.py").write_text("raise OSError('libGL.so.1: cannot open shared object file')\n")
    monkeypatch.syspath_prepend(tmp_path)
    findings = needs("numpy>=2.2", "scipy>=99", "not-there>=1", "broken-one")
    assert findings["numpy"] == Finding("numpy", True, metadata.version("numpy"))
    assert findings["scipy"].result == f"{metadata.version('scipy')} does not fit >=99"
    assert findings["scipy"].remedy == "pip install 'scipy>=99'"
    assert findings["not-there"].result == "is not installed"
    assert findings["broken-one"].result == "1.0 does not load: libGL.so.1: cannot open shared object file"
    assert [name for name, finding in findings.items() if not finding.is_fine] == ["scipy", "not-there", "broken-one"]
    monkeypatch.setattr(metadata, "version", Mock(side_effect=metadata.PackageNotFoundError("open3d")))
    finding = needs("open3d>=0.20")["open3d"]
    assert finding.is_fine and finding.result == "is not installed; the extra mesh has it"


@pytest.mark.parametrize(("is_fine", "code"), [(True, 0), (False, 1)])
def test_the_doctor_s_code_and_json_say_whether_all_is_well(is_fine, code, monkeypatch, capsys):
    monkeypatch.setattr(installation, "examine", lambda: iter([Finding("disk", is_fine, "little", "cd ELSEWHERE")]))
    assert cli.main(["doctor"]) == code
    assert ("type: cd ELSEWHERE" in capsys.readouterr().out) != is_fine
    assert cli.main(["doctor", "--json"]) == code
    report = json.loads(capsys.readouterr().out)
    assert report["is_well"] == is_fine and report["findings"][0]["name"] == "disk"


@pytest.mark.parametrize(
    ("fault", "command"),
    [
        ("raise ModuleNotFoundError('no such module')", r"pip install 'gsjax\[mesh\]'"),
        ("raise ImportError('libusb-1.0.so.0: cannot open\\nmore')", "sudo apt-get install libusb-1.0-0 libgl1"),
    ],
)
def test_what_is_missing_is_one_line_with_the_command_that_installs_it(tmp_path, monkeypatch, fault, command):
    (tmp_path / "open3d.py").write_text(fault)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    with pytest.raises(MissingPackageError) as error:
        require("open3d")
    assert re.fullmatch(rf"cannot load open3d \(.*\); install it with: {command}.*", str(error.value))


def test_a_signal_waits_until_a_package_is_loaded_and_its_handler_stays(tmp_path):
    """A compiled module would turn the exception of the handler into an ImportError, as this one does.

    pycolmap's log takes SIGTERM for itself, once in a process.
    """
    (tmp_path / "open3d.py").write_text("""
import signal
try:
    signal.raise_signal(signal.SIGTERM)
    loaded = True
except BaseException:
    raise ImportError("initialization failed") from None
""")
    program = f"""
import signal, sys
sys.path.insert(0, {str(tmp_path)!r})
from gsjax.cli.stopping import Stopping
from gsjax.io.packages import require
with Stopping() as stopping:
    try:
        require("open3d")
    except BaseException as stop:
        print(type(stop).__name__, sys.modules["open3d"].loaded, stopping.signal.name)
    require("pycolmap")
    signal.raise_signal(signal.SIGTERM)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (143, "SystemExit True SIGTERM\n", "")
