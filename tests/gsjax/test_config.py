from dataclasses import dataclass, field
from pathlib import Path
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
    normals: Path | None = None
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
            "normals": "maps",
            "background": [1, 1, 0.5],
            "loss": {"kind": "l2"},
            "phases": [{"name": "vanilla", "losses": [{"weight": 1}]}, {"name": "surface", "steps": 7}],
            "rates": {"means": 1},
        },
    )
    assert parsed == Settings(
        seed=3,
        normals=Path("maps"),
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
        ({"loss": {"wieght": 1}}, "config: unknown key 'loss.wieght'; the nearest known one is 'loss.weight'"),
        ({"kind": "l1"}, "config: unknown key 'kind'; the nearest known one is 'loss.kind'"),
        (
            {"phases": [{"name": "a"}, {"name": "b", "step": 1}]},
            "config: unknown key 'phases.1.step'; the nearest known one is 'phases.1.steps'",
        ),
        ({"seed": "many"}, "config: seed is 'many', expected int"),
        ({"seed": True}, "config: seed is True, expected int"),
        ({"seed": 1.5}, "config: seed is 1.5, expected int"),
        ({"masked": 1}, "config: masked is 1, expected bool"),
        ({"downscale": "2"}, "config: downscale is '2', expected int or null"),
        ({"loss": {"weight": float("nan")}}, "config: loss.weight is nan, expected a finite number"),
        ({"loss": {"weight": float("inf")}}, "config: loss.weight is inf, expected a finite number"),
        ({"rates": {"means": 10**400}}, "config: rates.means is an integer beyond 9007199254740992"),
        ({"seed": -(2**64)}, "config: seed is an integer beyond 9007199254740992"),
        ({"loss": {"kind": "l3"}}, """config: loss.kind is 'l3', expected one of "l1", "l2", 3"""),
        ({"loss": 3}, "config: loss is 3, expected a table of keys"),
        ({"background": [0, 1]}, "config: background is [0, 1], expected a list of 3: float, float, float"),
        ({"background": "ab"}, "config: background is 'ab', expected a list of 3: float, float, float"),
        ({"phases": [{}]}, "config: key 'phases.0.name' is missing"),
        ({"rates": {"means": "x"}}, "config: rates.means is 'x', expected float"),
        ({"loss": {"weight": 2}}, "config: loss: weight is 2.0, expected 0..1"),
        ({"final": {"weight": 2}}, "config: final: weight is 2.0, expected 0..1"),
        ({"final": {"kin": 2}}, "config: unknown key 'final.kin'; the nearest known one is 'final.kind'"),
        ([], "config: the whole is [], expected a table of keys"),
    ],
)
def test_every_fault_is_one_line_at_its_place(data, message):
    with pytest.raises(InputError) as caught:
        config.parse(Settings, data)
    assert str(caught.value) == message


def test_merge_is_deep_and_leaves_its_arguments_alone():
    base = {"a": {"b": 1, "c": [1, 2]}, "d": 4}
    merged = config.merge(base, {"a": {"c": [3]}}, {"a": {"b": 2}, "e": {"f": 1}}, {"d": {"g": 0}})
    assert merged == {"a": {"b": 2, "c": [3]}, "d": {"g": 0}, "e": {"f": 1}}
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": 4}


def test_override_reads_json_and_makes_tables_where_there_are_none():
    data = {"phases": [{"name": "a", "steps": 1}], "x": 1}
    result = config.override(
        data,
        ["phases.0.steps=5", "loss.weight=0.5", "loss.kind=l2", "masked=true", "normals=a=b", "downscale=null", "x="],
    )
    assert result == {
        "phases": [{"name": "a", "steps": 5}],
        "loss": {"weight": 0.5, "kind": "l2"},
        "masked": True,
        "normals": "a=b",
        "downscale": None,
        "x": "",
    }
    assert data == {"phases": [{"name": "a", "steps": 1}], "x": 1}


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("seed", "--set seed: expected key=value, for example --set seed=3"),
        ("=3", "--set =3: expected key=value, for example --set seed=3"),
        ("seed.x=3", "--set seed.x=3: 'x' is no key or place in 1"),
        ("phases.2.steps=3", "--set phases.2.steps=3: '2' is no key or place in [{}]"),
    ],
)
def test_an_assignment_that_cannot_be_made(assignment, message):
    with pytest.raises(InputError) as caught:
        config.override({"seed": 1, "phases": [{}]}, [assignment])
    assert str(caught.value) == message


PHASED = {"phases": [{"name": "coarse", "steps": 1}, {"name": "surface", "steps": 2, "rates": {"means": 0.1}}]}


def test_items_of_a_list_are_reached_by_their_names_and_by_number():
    changed = config.override(PHASED, ["phases.surface.steps=7", "phases.0.steps=5", "phases.surface.rates.quats=0.2"])
    coarse, surface = changed["phases"]
    assert (coarse["steps"], surface["steps"], surface["rates"]) == (5, 7, {"means": 0.1, "quats": 0.2})
    assert PHASED["phases"][1]["steps"] == 2
    merged = config.merge(PHASED, {"phases": {"surface": {"rates": {"quats": 0.2}}, "0": {"steps": 5}}})
    assert merged["phases"] == [{**coarse}, {**surface, "steps": 2}]


def test_a_name_that_no_item_has_is_one_line_with_those_there_are():
    with pytest.raises(InputError, match=r"^--set phases\.surfac\.steps=1: 'surfac' is none of coarse, surface, 0, 1$"):
        config.override(PHASED, ["phases.surfac.steps=1"])
    with pytest.raises(InputError, match="'surfac' is none of coarse, surface, 0, 1"):
        config.merge(PHASED, {"phases": {"surfac": {"steps": 1}}})
