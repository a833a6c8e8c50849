"""Boundary conditions that a user's program registers, used from scenes."""

import json
from collections.abc import Sequence
from typing import Any

import pytest
from pydantic import Field
from scenes import changed, parse_plane

from cosserat_fx.conditions import Condition, Work
from cosserat_fx.extensions import BoundaryContext, register
from cosserat_fx.material import Material
from cosserat_fx.scene import SceneError, parse_scene
from cosserat_fx.scenes import registry
from cosserat_fx.scenes.histories import DisplacementHistory
from cosserat_fx.scenes.schema import Table


class Spring(Table):
    stiffness: float = Field(gt=0)
    anchor: DisplacementHistory = 0.0

    def conditions(self, boundary: str, context: BoundaryContext) -> Sequence[Condition]:
        anchor = context.history(self.anchor, 0.0)
        return [Work(lambda u, w, v, q, ds: -self.stiffness * (u[0] - anchor(1.0)) * v[0] * ds, boundary)]


@pytest.fixture
def spring(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table known by the key "spring", for a while."""
    monkeypatch.setattr(registry, "_tables", {})
    register("spring", Spring)


@pytest.mark.usefixtures("spring")
def test_a_scene_may_use_a_registered_table() -> None:
    scene = parse_plane(changed({"boundaries.left.spring": {"stiffness": 3, "anchor": [0.0, 0.02]}}))
    (table,) = scene.boundaries["left"].extensions.values()
    assert table == Spring(stiffness=3.0, anchor=(0.0, 0.02))
    assert scene.boundaries["top"].extensions == {}
    assert scene.leg_lengths == pytest.approx((0.01, 0.02))
    assert parse_scene(json.loads(json.dumps(scene.as_dict()))) == scene
    sand = Material.named("paper-sand")
    context = BoundaryContext(lambda history, start: lambda travel: start, sand, True, sand.d50)
    assert isinstance(table, Spring)
    (condition,) = table.conditions("left", context)
    assert isinstance(condition, Work)
    assert condition.boundary == "left"


@pytest.mark.usefixtures("spring")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"boundaries.left.sprin": 1},
            "boundaries.left.sprin = 1: unknown key, did you mean spring? The keys here are u1",
        ),
        ({"boundaries.left.spring": 1}, "boundaries.left.spring = 1: must be a table with the keys stiffness, anchor"),
        (
            {"boundaries.left.spring": {}},
            "boundaries.left.spring.stiffness is missing: must be a finite number greater",
        ),
        ({"boundaries.left.spring": {"stifness": 1}}, "spring.stifness = 1: unknown key, did you mean stiffness?"),
        ({"boundaries.left.spring": {"stiffness": 0}}, "boundaries.left.spring.stiffness = 0: must be a finite number"),
        (
            {"boundaries.left.spring": {"stiffness": 1, "anchor": [1, 2]}, "boundaries.top.u2": [1, 2, 3]},
            "boundaries.left.spring.anchor = [1.0, 2.0]: must have one entry for each leg",
        ),
    ],
)
def test_a_registered_table_is_checked_like_the_others(changes: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(changed(changes))
    assert message in str(caught.value)


def test_a_table_that_nobody_registered_is_unknown() -> None:
    with pytest.raises(SceneError, match=r"boundaries.left.spring = \{\}: unknown key"):
        parse_scene(changed({"boundaries.left.spring": {}}))


@pytest.mark.usefixtures("spring")
@pytest.mark.parametrize(
    ("name", "table", "error"),
    [
        ("u1", Spring, ValueError),
        ("extensions", Spring, ValueError),
        ("two words", Spring, ValueError),
        ("spring", type("Other", (Spring,), {}), ValueError),
        ("plain", Table, TypeError),
        ("number", float, TypeError),
    ],
)
def test_a_table_that_does_not_fit_is_not_registered(name: str, table: Any, error: type[Exception]) -> None:
    before = dict(registry.registered())
    with pytest.raises(error):
        register(name, table)
    assert dict(registry.registered()) == before
    register("spring", Spring)  # the same again changes nothing
