"""Bodies that were walked, with the answers of their runs."""

from typing import Any

import planes
from layers import scene
from planes import BIAXIAL

from cosserat_fx import layer
from cosserat_fx._compat import MPI
from cosserat_fx.answer.report import Answer
from cosserat_fx.bodies import Body

SHORT = ("walls.top.shear_displacement=0.002", "output.profiles_at=[]")
TOLERANCE = 1e-9
"""Of the solver's forces, by default."""


def walked(body: Body, steps: int = 1000) -> Answer:
    """The answer after some steps, not yet checked."""
    answer = Answer(body)
    for step in body.stepper:
        answer.observe(step)
        if step.number == steps:
            break
    return answer


def sheared(*overrides: str) -> tuple[Body, Answer]:
    """A layer of a demo and its answer."""
    body = layer.build(scene("medium_rough", *SHORT, *overrides), MPI.COMM_SELF)
    return body, walked(body)


def squeezed(changes: dict[str, Any] | None = None, steps: int = 1000) -> tuple[Body, Answer]:
    """A plane body under biaxial compression and its answer."""
    body = planes.build(BIAXIAL | (changes or {}))
    return body, walked(body, steps)


def checked(answer: Answer) -> dict[str, Any]:
    answer.check()
    return answer.entries()


def assert_holds(answer: Answer) -> dict[str, Any]:
    """Every check holds, within limits that say something."""
    found = checked(answer)
    assert answer.warnings() == []
    assert all(it["holds"] for it in found.values())
    for name in ("equilibrium", "reactions", "energy"):
        assert found[name]["limit"] < 100 * TOLERANCE
    assert found["range"]["value"] == 0
    return found
