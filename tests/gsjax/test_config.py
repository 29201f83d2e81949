from dataclasses import dataclass, field
from typing import Literal

import pytest

from gsjax import config
from gsjax.errors import InputError


@dataclass(frozen=True)
class Loss:
    weight: float = 0.2
    kind: Literal["l1", "l2", 3] = "l1"

    def __post_init__(self):
        if not 0 <= self.weight <= 1:
            raise ValueError(f"weight is {self.weight}, expected 0..1")


@dataclass(frozen=True)
class Phase:
    name: str
    steps: int = 100
    losses: tuple[Loss, ...] = (Loss(),)


@dataclass(frozen=True)
class Settings:
    seed: int = 0
    downscale: int | None = None
    masked: bool = False
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    loss: Loss = Loss()
    final: Loss | None = None
    phases: tuple[Phase, ...] = ()
    rates: dict[str, float] = field(default_factory=dict)


def test_defaults_and_nested_values():
    parsed = config.parse(
        Settings,
        {
            "seed": 3,
            "background": [1, 1, 0.5],
            "loss": {"kind": "l2"},
            "phases": [{"name": "vanilla", "losses": [{"weight": 1}]}, {"name": "surface", "steps": 7}],
            "rates": {"means": 1},
        },
    )
    assert parsed == Settings(
        seed=3,
        background=(1.0, 1.0, 0.5),
        loss=Loss(kind="l2"),
        phases=(Phase("vanilla", losses=(Loss(1.0),)), Phase("surface", 7)),
        rates={"means": 1.0},
    )
    assert isinstance(parsed.phases[0].losses[0].weight, float)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"sead": 1}, "config: unknown key 'sead'; the nearest known one is 'seed'"),
        (
            {"phases": [{"name": "a"}, {"name": "b", "step": 1}]},
            "config: unknown key 'phases.1.step'; the nearest known one is 'phases.1.steps'",
        ),
        ({"seed": True}, "config: seed is True, expected int"),
        ({"downscale": "2"}, "config: downscale is '2', expected int or null"),
        ({"loss": {"weight": float("nan")}}, "config: loss.weight is nan, expected a finite number"),
        ({"rates": {"means": 10**400}}, "config: rates.means is an integer beyond 9007199254740992"),
        ({"loss": {"kind": "l3"}}, """config: loss.kind is 'l3', expected one of "l1", "l2", 3"""),
        ({"background": [0, 1]}, "config: background is [0, 1], expected a list of 3: float, float, float"),
        ({"phases": [{}]}, "config: key 'phases.0.name' is missing"),
        ({"loss": {"weight": 2}}, "config: loss: weight is 2.0, expected 0..1"),
        ([], "config: the whole is [], expected a table of keys"),
    ],
)
def test_every_fault_is_one_line_at_its_place(data, message):
    with pytest.raises(InputError) as caught:
        config.parse(Settings, data)
    assert str(caught.value) == message


PHASED = {"phases": [{"name": "coarse", "steps": 1}, {"name": "surface", "steps": 2, "rates": {"means": 0.1}}]}


def test_merge_is_deep_and_leaves_its_arguments_alone():
    base = {"a": {"b": 1, "c": [1, 2]}, "d": 4}
    merged = config.merge(base, {"a": {"c": [3]}}, {"a": {"b": 2}, "e": {"f": 1}}, {"d": {"g": 0}})
    assert merged == {"a": {"b": 2, "c": [3]}, "d": {"g": 0}, "e": {"f": 1}}
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": 4}
    merged = config.merge(PHASED, {"phases": {"surface": {"rates": {"quats": 0.2}}, "0": {"steps": 5}}})
    assert [phase["steps"] for phase in merged["phases"]] == [5, 2]
    assert merged["phases"][1]["rates"] == {"means": 0.1, "quats": 0.2}
    with pytest.raises(InputError, match="'surfac' is none of coarse, surface, 0, 1"):
        config.merge(PHASED, {"phases": {"surfac": {"steps": 1}}})


def test_override_reads_json_makes_tables_and_reaches_items_of_lists():
    texts = ["phases.0.steps=5", "phases.surface.steps=7", "loss.weight=0.5", "loss.kind=l2", "normals=a=b", "x="]
    result = config.override({**PHASED, "x": 1}, [*texts, "masked=true", "downscale=null"])
    phases = [{"name": "coarse", "steps": 5}, {**PHASED["phases"][1], "steps": 7}]
    plain = {"loss": {"weight": 0.5, "kind": "l2"}, "normals": "a=b", "x": "", "masked": True, "downscale": None}
    assert result == {"phases": phases, **plain}
    assert PHASED["phases"][1]["steps"] == 2


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("seed", "--set seed: expected key=value, for example --set seed=3"),
        ("seed.x=3", "--set seed.x=3: 'x' is no key or place in 1"),
        ("phases.b.steps=1", "--set phases.b.steps=1: 'b' is none of a, 0"),
    ],
)
def test_an_assignment_that_cannot_be_made(assignment, message):
    with pytest.raises(InputError) as caught:
        config.override({"seed": 1, "phases": [{"name": "a"}]}, [assignment])
    assert str(caught.value) == message
