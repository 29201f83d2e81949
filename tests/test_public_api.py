import importlib
import inspect
import re
from pathlib import Path

import pytest

import gsjax
import rasterizer

DOCS = Path(__file__).resolve().parents[1] / "docs"
PUBLIC = [(package, name) for package in (rasterizer, gsjax) for name in package.__all__]


@pytest.mark.parametrize(("package", "name"), PUBLIC, ids=[f"{p.__name__}.{n}" for p, n in PUBLIC])
def test_every_public_name_is_documented_and_listed(package, name):
    value = getattr(package, name)
    if inspect.isclass(value) or inspect.isfunction(value):
        assert inspect.getdoc(value), f"{name} has no docstring"
    assert re.search(rf"`{package.__name__}\.{name}`", (DOCS / "api.md").read_text()), "not listed in docs/api.md"


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'gsjax' has no attribute 'Nothing'"):
        _ = gsjax.Nothing


<<<<<<< HEAD
def test_every_study_benchmark_and_picture_has_its_command():
    text, experiments = (DOCS / "reproducing.md").read_text(), DOCS.parent / "experiments"
    benchmarks = (file for file in experiments.glob("benchmarks/*.py") if "__main__" in file.read_text())
    assert not [file.name for file in benchmarks if f"benchmarks/{file.name}" not in text and file.stem != "steps"]
    for command, folder in (("COMPARE", "studies"), ("REMESH", "remeshing")):
        studies = {file.stem for file in experiments.glob(f"{folder}/*.py")}
        assert studies == set(re.findall(rf"`{command} (\w+)", text))
    pictures = {file.name for file in (DOCS / "assets").iterdir()}
    assert pictures == {name for name in pictures if name in text}
    for script in re.findall(r"`python (experiments/[\w/]+\.py)", text):
        assert (DOCS.parent / script).is_file(), script
=======
PAGES = [DOCS.parent / "README.md", *sorted(DOCS.glob("*.md")), DOCS.parent / "experiments/README.md"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_settings_on_the_pages_are_right(page):
    text = page.read_text()
    for command in re.findall(r"^    gsjax (.*?)(?:  #.*)?$", text, re.MULTILINE):
        assert cli.parser().parse_args(command.split()).run
    kind, preset = (Refinement, {}) if page.name == "refinement.md" else (Settings, PRESETS["fast"])
    for assignment in re.findall(r"--set (\w+(?:\.\w+)+=[\w.]+)", text):
        whole = config.to_dict(config.parse(kind, preset))
        config.parse(kind, config.override(whole, [assignment]))
>>>>>>> d56e4b0 (Every figure and its command: one row a script, three columns; pages of results say what their command is called today)


def test_what_the_map_of_the_paper_points_to_exists():
    text = (DOCS / "paper_map.md").read_text()
    functions = re.findall(r"`(gsjax(?:\.\w+)+)`", text)
    tests = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", text)
    assert functions
    assert tests
    for dotted in functions:
        module, _, name = dotted.rpartition(".")
        assert hasattr(importlib.import_module(module), name), dotted
    for file, name in tests:
        path = DOCS.parent / file
        assert path.is_file(), file
        assert f"def {name}" in path.read_text(), f"{file}::{name}"
