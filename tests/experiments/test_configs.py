import pytest

from gsjax import config
from gsjax.presets import DEMO
from gsjax.settings import Settings

CONFIGS = ["base", "built_in", "bunny_plane", "demo", "fox"]


@pytest.fixture
def script(scripts):
    return scripts("train")


@pytest.mark.parametrize("name", CONFIGS)
def test_every_config_parses_and_differs_from_base_in_what_it_says(script, name):
    assert sorted(script.CONFIGS) == CONFIGS
    settings, base, own = script.load_settings(name), script.CONFIGS["base"], script.CONFIGS[name]
    assert settings == config.parse(Settings, config.merge(base, own))
    if name != "base":
        assert all(base.get(key) != value for key, value in own.items()), "a config holds differences only"


def test_the_demo_is_what_the_command_trains(script):
    assert script.load_settings("demo") == config.parse(Settings, DEMO)
