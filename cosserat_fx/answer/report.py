"""The answer of a run, checked at its end: in numbers for ``run.json``, in one line, in warnings."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import TYPE_CHECKING, Any

from cosserat_fx.answer import checks
from cosserat_fx.answer.accounts import Accounts
from cosserat_fx.answer.checks import Check
from cosserat_fx.stepping import Step

if TYPE_CHECKING:
    from cosserat_fx.bodies import Body

_COMPLAINTS = {
    "equilibrium": "the answer is not in equilibrium: it is out of balance by {value:.3g} of the internal forces, "
    "most of all {where}",
    "reactions": "what acts on the body does not balance: {where} that is left is {value:.3g} of the internal forces",
    "mass": "mass is not conserved: void ratio and displacements disagree by {value:.3g} in the volume at {where}",
    "energy": "the work put in and that of the stresses differ by {value:.3g} of the energy turned over",
    "dissipation": "the stresses give back more than was put in, by {value:.3g} of the energy turned over",
}


class Answer:
    """Keeps a run's accounts and checks its answer.

    Everything but the accounts is looked at once, at the end. What a checkpoint has to hold are the numbers of
    :meth:`memento`; the void ratio of the start is that of the problem at construction, before anything is restored.
    """

    def __init__(self, body: Body) -> None:
        """Begin with the initial state. Collective.

        Args:
            body: what is run, before its first step and before a checkpoint is read.
        """
        self._problem, self._solver = body.problem, body.stepper.solver
        state = self._problem.state
        self._initial_void_ratio = state.e_n[state.points].copy()
        self._accounts = Accounts(self._problem)
        self._problem.before_commit = self._accounts.add
        self._steps, self._travel, self._accepted = 0, 0.0, 0.0
        self._found: dict[str, Check] = {}

    def observe(self, step: Step) -> None:
        """Note up to which norm of the out-of-balance forces a step just committed was taken for done.

        That is the solver's tolerance or, where rounding keeps it from being met, what the solver stopped at.
        """
        snes = self._solver.snes
        accepted = float(snes.getTolerances()[1])
        if snes.getConvergedReason() < 0:
            accepted = max(accepted, float(snes.getFunctionNorm()))
        mean = (accepted + self._accepted) / 2
        self._accounts.sums.unbalanced += mean * self._accounts.displacement
        self._steps, self._travel, self._accepted = step.number, step.travel, accepted

    def check(self) -> None:
        """Check the committed state, after at least one step. Collective."""
        problem = self._problem
        problem.apply(self._travel)
        forces = checks.balance(problem, self._accepted)
        layer = problem.geometry.dimension == "layer"
        found = {
            "equilibrium": (checks.constancy if layer else checks.nodal_equilibrium)(problem, forces),
            "reactions": checks.reactions(problem, forces),
        }
        if problem.numerics.void_ratio:
            gradients, rule = self._accounts.gradients, self._accounts.sums.rule
            found["mass"] = checks.mass(problem, self._initial_void_ratio, gradients, rule, self._steps)
        found["range"] = checks.admissible(problem)
        self._found = found | self._energy()

    def _energy(self) -> dict[str, Check]:
        """Energy put in against work of the stresses, and the part of the latter that is lost.

        Both are relative to the turnover. The sums agree but for the work of the out-of-balance forces, which the
        solver's tolerance bounds, and for rounding.
        """
        sums = self._accounts.sums
        turnover = sums.turnover or 1.0
        hourglass = self._problem.hourglass_energy()
        dissipated = sums.stresses - sums.recoverable
        limit = (sums.unbalanced + sums.rounding) / turnover
        unit = "J_per_m2" if self._problem.geometry.dimension == "layer" else "J_per_m"
        works = {"put_in": sums.external, "of_stresses": sums.stresses, "of_stabilisation": hourglass}
        return {
            "energy": Check(
                abs(sums.external - sums.stresses - hourglass) / turnover,
                limit,
                further={f"{name}_{unit}": value for name, value in works.items()},
            ),
            "dissipation": Check(max(0.0, -dissipated) / turnover, limit, further={f"dissipated_{unit}": dissipated}),
        }

    def entries(self) -> dict[str, Any]:
        """The checks by name as in ``run.json``, null for what is no number; nothing before :meth:`check`."""
        return {
            name: {
                "value": it.value if isfinite(it.value) else None,
                "limit": it.limit,
                "holds": it.holds,
                "where": it.where or None,
                **it.further,
            }
            for name, it in self._found.items()
        }

    def line(self) -> str:
        """The checks in one line; empty before :meth:`check`."""
        if not self._found:
            return ""
        told = [
            f"{name} {it.value:.0e}" + ("" if it.holds else f" (limit {it.limit:.0e})")
            for name, it in self._found.items()
            if name not in ("range", "dissipation")
        ]
        outside = self._found["range"].value
        share = f"{100 * outside:.2g} % of the points not admissible" if outside else "all points admissible"
        lost = self._accounts.sums.stresses - self._accounts.sums.recoverable
        unit = "J/m2" if self._problem.geometry.dimension == "layer" else "J/m"
        return ", ".join([*told, f"{lost:.4g} {unit} dissipated", share])

    def warnings(self) -> list[str]:
        """A sentence for each check that does not hold; points looser than e_i are told when they first appear."""
        return [told for name, it in self._found.items() if not it.holds and (told := _complaint(name, it))]

    def memento(self) -> dict[str, float]:
        """What a checkpoint has to hold."""
        own = {"steps": self._steps, "travel": self._travel, "accepted": self._accepted}
        return own | self._accounts.memento()

    def restore(self, memento: Mapping[str, float]) -> None:
        """Go on from a state that has been put back. Collective.

        Args:
            memento: what :meth:`memento` gave.
        """
        sums = dict(memento)
        self._steps = int(sums.pop("steps"))
        self._travel, self._accepted = sums.pop("travel"), sums.pop("accepted")
        self._problem.apply(self._travel)
        self._accounts.restore(self._problem, sums)


def _complaint(name: str, check: Check) -> str:
    """What to say about a check that does not hold."""
    if name == "range":
        graver = ", ".join(f"{check.further[it]} {it.replace('_', ' ')}" for it in checks.GRAVER if check.further[it])
        return graver and f"points are outside the range of the law at the end: {graver}, the first at {check.where}"
    found = _COMPLAINTS[name].format(value=check.value, where=check.where)
    return f"{found}; step sizes and tolerances account for up to {check.limit:.3g}"
