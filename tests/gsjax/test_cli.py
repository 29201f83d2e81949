import json
import sys

import pytest

import gsjax
from gsjax import cli, config, runs
from gsjax.presets import LENGTHS, PRESETS, preset
from gsjax.settings import Phase, Schedule, Settings

pytestmark = pytest.mark.usefixtures("own_environment")


def train_settings(library, *arguments):
    assert cli.main(["train", "scene", *arguments]) == 0
    name, (scene, _, settings), keywords = library[-1]
    assert (name, scene) == ("train", "scene")
    return settings, keywords


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_the_help_of_a_command_has_an_example_that_parses(command, capsys):
    assert cli.main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"usage: gsjax {command}" in text
    program, *example = text.split("example:\n")[1].split()
    assert program == "gsjax" and cli.parser().parse_args(example).run


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "gsjax: error: the following arguments are required: COMMAND (see gsjax --help)"),
        (["train", "s", "--out", "r", "--downscale", "inf"], "argument --downscale: inf: not a finite number"),
        (
            ["train", "s", "--out", "r", "--coordinator", "x:y", "--processes", "2"],
            "coordinator=x:y: is no HOST:PORT",
        ),
        (["train", "s", "--out", "r", "--port", "81"], "--port goes with --view"),
        (["train", "s", "--out", "r", "--budget", "soon"], "--budget soon: not a time, such as 90s, 10m or 1.5h"),
        (["train", "s", "--out", "r", "--devices", "few"], "--devices few: not a number of devices, nor all"),
        (["train", "s", "--out", "r", "--devices", "2", "--budget", "9m"], "--budget: needs one device and"),
    ],
)
def test_wrong_arguments_are_one_line_and_code_2(arguments, message, capsys):
    assert cli.main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        "eval gone", "render gone --out o", "mesh gone --out m.ply", "convert gone g.spz", "view gone", "report gone",
        "share gone --out s.html", "refine gone --mesh m.ply --out o", "texture gone --mesh m.ply --out m.glb",
        "clean gone", "scale gone --between a 1 1 b 2 2", "undistort gone --out o", "diagnose gone",
        "compare gone away --out c.html", "sfm gone --out o", "blocks gone --out o --blocks 2",
    ],
)  # fmt: skip
def test_what_does_not_exist_is_told_as_such(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments.split()) == 2
    error = capsys.readouterr().err
    assert error.startswith("gsjax: error: gone: no such f") and error.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} <= {"cache"}


def test_settings_come_from_the_preset_the_options_and_set(library):
    settings, keywords = train_settings(library, "--out", "r")
    assert settings == config.parse(Settings, PRESETS["fast"])
    assert keywords == {"resume": False}
    options = ["--preset", "balanced", "--seed", "3", "--downscale", "2", "--background", "white", "--vanilla"]
    options += ["--normals", "maps", "--masks", "matte", "--images", "images_4", "--hold-out", "5"]
    settings, _ = train_settings(library, "--out", "r", *options)
    changes = {
        "seed": 3,
        "photos": {"downscale": 2, "masks": "matte", "images": "images_4", "hold_out": "5"},
        "model": {"background": "white"},
        "schedule": {"vanilla": True},
        "supervision": {"normals": "maps"},
    }
    assert settings == preset("balanced", changes)
    options = ["--seed", "3", "--normals", "--set", "seed=4", "schedule.phases.1.steps=9", "--set", "rates.quats=1"]
    settings, _ = train_settings(library, "--out", "r", *options)
    assert (settings.seed, settings.schedule.phases[1].steps, settings.rates.quats) == (4, 9, 1.0)
    assert settings.supervision.normals == "auto", "whatever the scene holds"


def test_a_budget_chooses_the_settings_once_and_a_resumed_run_keeps_them(library, tmp_path, monkeypatch, capsys):
    calls = []

    def budgeted(scene, candidates, seconds, lasting):
        calls.append((scene, list(candidates), seconds, lasting))
        return next(iter(candidates.values())).replace(schedule={"sh_every": 77}), "fast, 0.5 times its steps"

    for name, value in {"budgeted": budgeted, "scaled": "steps", "resized": "steps and Gaussians"}.items():
        monkeypatch.setattr(sys.modules["gsjax.pipeline"], name, value, raising=False)
    run = str(tmp_path / "run")
    settings, _ = train_settings(library, "--out", run, "--budget", "10m", "--seed", "3")
    assert (settings.schedule.sh_every, settings.seed) == (77, 3)
    assert capsys.readouterr().err.splitlines() == ["budget of 10m: fast, 0.5 times its steps"]
    train_settings(library, "--out", run, "--budget", "1h", "--preset", "balanced", "--set", "model.max_gaussians=50")
    assert calls == [
        ("scene", list(LENGTHS), 600, "steps and Gaussians"),
        ("scene", ["balanced"], 3600, "steps"),  # keeps the number that was asked for
    ]
    runs.create(run, config.to_dict(settings), scene="scene", seed=3)
    assert train_settings(library, "--out", run, "--budget", "10m", "--resume")[0] == settings
    assert cli.main(["train", "scene", "--out", run, "--budget", "10m"]) == 2
    assert "this folder is not empty" in capsys.readouterr().err and len(calls) == 2


def test_a_list_of_held_out_photos_is_read_again_from_wherever_the_run_is_scored(library, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "list.txt").write_text("a.png")
    settings, _ = train_settings(library, "--out", "r", "--hold-out", "list.txt")
    assert settings.photos.hold_out == str(tmp_path / "list.txt")


def test_a_resumed_run_keeps_the_settings_that_it_was_started_with(library, tmp_path, capsys):
    started = Settings(seed=5, schedule=Schedule(phases=(Phase("vanilla", 7),)))
    for stored, options in ((started, []), (preset("fast", {"seed": 7}), ["--preset", "fast"])):
        (tmp_path / "config.json").write_text(json.dumps(config.to_dict(stored)))
        assert train_settings(library, "--out", str(tmp_path), "--resume", *options) == (stored, {"resume": True})
    settings, _ = train_settings(library, "--out", str(tmp_path / "new"), "--resume")
    assert settings == config.parse(Settings, PRESETS["fast"])
    (tmp_path / "config.json").write_text('{"model": {"cloud": 3}}')  # of an earlier version
    cli.main(["train", "scene", "--out", str(tmp_path), "--resume"])
    assert f"error: {tmp_path}/config.json: unknown key 'model.cloud'; the nearest" in capsys.readouterr().err


CALLS = {
    "mesh g.ply --out m.obj --depth 9 --bounds -1 -1.5 0 1 1 2": (
        ("mesh", ("g.ply",), {"out": "m.obj", "depth": 9, "bounds": [-1, -1.5, 0, 1, 1, 2]})
    ),
    "view g.spz --mesh m.glb --port 81 --host 0": ("view", ("g.spz",), {"mesh": "m.glb", "port": 81, "host": "0"}),
    "masks photos --network u2net --weights m.onnx --classes person,sky": (
        ("masks", (), {"photos": "photos", "network": "u2net", "weights": "m.onnx", "classes": ["person", "sky"]})
    ),
    "render run --out o --held-out": ("render", (), {"source": "run", "out": "o", "views": "held_out"}),
    "eval run --lpips vgg.onnx --lpips alex.onnx --three-ways": (
        ("evaluate", ("run",), {"mesh": None, "lpips": ["vgg.onnx", "alex.onnx"], "three_ways": True})
    ),
}


@pytest.mark.parametrize("arguments", CALLS)
def test_a_command_hands_over_what_was_given_and_nothing_else(library, arguments):
    assert cli.main(arguments.split()) == 0
    assert library == [CALLS[arguments]]


def test_a_training_is_watched_where_it_is_asked_for(library):
    assert cli.main(["train", "scene", "--out", "r", "--view", "--port", "81"]) == 0
    (_, (scene, settings), address), (name, (*_, trained), keywords) = library
    assert (scene, address, name) == ("scene", {"port": 81}, "train")
    assert settings == trained and keywords == {"resume": False, "observe": "told of every step"}


def test_eval_writes_json_and_prints_a_table_and_what_is_not_scored(library, tmp_path, capsys, monkeypatch):
    assert cli.main(["eval", "run", "--json", str(tmp_path / "a/e.json"), "--mesh", "m.ply"]) == 0
    assert json.loads((tmp_path / "a/e.json").read_text()) == {"psnr": 29.5, "views": 7}
    printed = capsys.readouterr()
    assert printed.out == "psnr   29.5\nviews  7\n"
    assert printed.err == "LPIPS is not scored: --lpips FILE names its weights\n"
    monkeypatch.setattr(gsjax.pipeline, "evaluate", lambda *args, **kwargs: {"psnr": None, "views": 0})
    assert cli.main(["eval", "run"]) == 0
    assert capsys.readouterr() == ("psnr   -\nviews  0\n", "run: no held-out views to score pictures by\n")


def test_sfm_names_the_photos_that_are_left_out_by_their_reasons(library, capsys):
    assert cli.main(["sfm", "photos", "--out", "scene"]) == 0
    printed = capsys.readouterr()
    assert "registered    45\nleft_out      3\npassed_over   0\n" in printed.out
    assert "\nonly 45 of 100 photos are in the model, less than half: see the photos left out above" in printed.out
    assert printed.err == "gsjax: left out (blurred): a.jpg\ngsjax: left out (dark): b.jpg, c.jpg\n"
