"""The path, and the walk along it: on a bar of one unknown whose answers are known, and on a layer."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from layers import SAND, scene

from cosserat_fx._compat import MPI
from cosserat_fx.layer import build, layer_path
from cosserat_fx.newton import NewtonSolver, Solution
from cosserat_fx.path import Path, Waypoint
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import Step, StepControl, Stepper, SteppingError


def nearly_even(travel: float) -> float:
    """A strain that hardly asks for small steps."""
    return travel + 1e-9 * travel**2


class Bar:
    """A problem and its solver in one: the unknown is the travel, the strain a given function of it.

    Attributes:
        calls: what the stepper asked for, in order.
        guesses: the unknown as predicted from the last increment, in order.
        fails: tells from the travels at both ends of a step whether it fails.
        substeps: what its one point asks for.
    """

    comm = MPI.COMM_SELF

    def __init__(self, strain: Callable[[float], float] = nearly_even, *, iterations: int = 3) -> None:
        self.unknown = SimpleNamespace(x=SimpleNamespace(array=np.zeros(1)))
        self.committed = SimpleNamespace(x=SimpleNamespace(array=np.zeros(1)))
        self.calls: list[str] = []
        self.guesses: list[float] = []
        self.fails: Callable[[float, float], bool] = lambda begin, end: False
        self.substeps = 1
        self._strain, self._iterations = strain, iterations
        self._target = 0.0

    def apply(self, travel: float) -> None:
        self._target = travel

    def impose(self) -> None:
        self.calls.append("follow")
        self.guesses.append(float(self.unknown.x.array[0]))

    def predict(self) -> bool:
        self.calls.append("predict")
        return True

    def largest_strain(self) -> float:
        return 0.0

    @property
    def state(self) -> SimpleNamespace:
        substeps = np.array([self.substeps])
        return SimpleNamespace(restart_substeps=lambda: None, substeps=substeps, points=np.array([0]))

    def out_of_balance(self) -> float:
        return 1.0

    def explanation(self) -> str:
        return "where it is thin"

    def solve(self) -> Solution:
        if self.fails(float(self.committed.x.array[0]), self._target):
            self.calls.append("fail")
            return Solution(False, self._iterations, "it snapped at 1 m", 1.0)
        self.unknown.x.array[0] = self._target
        self.calls.append("solve")
        return Solution(True, self._iterations, "converged", 0.0)

    def strain_increments(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        begin, end = self.committed.x.array[0], self.unknown.x.array[0]
        return np.array([[self._strain(end) - self._strain(begin)]])

    def commit(self) -> None:
        self.calls.append("commit")
        self.committed.x.array[:] = self.unknown.x.array

    def roll_back(self) -> None:
        self.calls.append("roll back")
        self.unknown.x.array[:] = self.committed.x.array

    def walk(self, corners: list[float], stations: list[float], control: StepControl) -> Iterator[Step]:
        problem, solver = cast("Problem", self), cast("NewtonSolver", self)
        return iter(Stepper(problem, solver, corners, stations, control))


@pytest.fixture(autouse=True)
def nothing_moves_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar is either in equilibrium or not: nothing comes of letting it move."""
    monkeypatch.setattr("cosserat_fx.stepping.relax", lambda *arguments: None)


lengths = st.floats(min_value=1e-3, max_value=10.0)

# -- the path ----------------------------------------------------------------------------------------------------------


def test_travel_adds_up_over_the_legs_and_the_walls_follow() -> None:
    path = Path([Waypoint(4.0, 0.0, 4.0), Waypoint(-4.0, 1.0, 9.0), Waypoint(4.0, 0.0, 9.0)])
    assert (path.corners, path.length) == ([0.0, 4.0, 13.0, 22.0], 22.0)
    assert [path.top(travel) for travel in (0.0, 1.0, 4.0, 8.5, 13.0, 22.0)] == [0.0, 1.0, 4.0, 0.0, -4.0, 4.0]
    assert [path.bottom(travel) for travel in (4.0, 8.5, 13.0, 22.0)] == [0.0, 0.5, 1.0, 0.0]
    assert path.at(1, 0.5) == 8.5
    assert path.at(1, 1.0) == 13.0


def test_walls_that_move_together_move_the_layer() -> None:
    """Where both walls go the same way the travel is that of the faster one."""
    wanted = scene(
        "very_rough",
        "walls.bottom={shear_displacement=[0.0, 0.01, 0.03]}",
        "walls.top={shear_displacement=[0.001, 0.011, 0.021], normal_stress=-100e3}",
        "output.profiles_at=[]",
    )
    assert np.diff(layer_path(wanted).corners) == pytest.approx([0.001, 0.01, 0.02])


def test_the_normal_stress_comes_before_the_shear() -> None:
    path = layer_path(scene("medium_rough", "walls.top.normal_stress=-200e3"))
    loaded = path.corners[1]
    assert loaded > 0
    assert [path.load(travel) for travel in (0.0, loaded / 4, loaded, path.length)] == [0.0, 0.25, 1.0, 1.0]
    assert [path.top(travel) for travel in (0.0, loaded, path.length)] == [0.0, 0.0, 0.03]


@given(
    top=st.floats(1e-4, 0.1) | st.floats(-0.1, -1e-4),
    fractions=st.lists(st.floats(0.01, 1.0), min_size=1, max_size=5, unique=True),
)
def test_stations_of_a_scene_lie_where_they_were_asked_for(top: float, fractions: list[float]) -> None:
    """Up to the last bit or two of the wall's way: a station is a fraction of its leg."""
    asked = sorted({fraction * top for fraction in fractions}, key=abs)
    asked = [a for k, a in enumerate(asked) if k == 0 or abs(a - asked[k - 1]) > 1e-6 * abs(top)]
    wanted = scene("medium_rough", f"walls.top.shear_displacement={top!r}", f"output.profiles_at={asked!r}")
    path = layer_path(wanted)
    travels = [path.at(station.leg, station.fraction) for station in wanted.profile_stations]
    assert [path.top(travel) for travel in travels] == pytest.approx(asked, rel=0, abs=4e-16 * abs(top))


# -- the walk ----------------------------------------------------------------------------------------------------------


@given(
    legs=st.lists(lengths, min_size=1, max_size=4),
    percents=st.lists(st.integers(0, 100), max_size=5),
    first=st.floats(1e-2, 5.0),
    largest=st.floats(0.3, 20.0),
)
def test_every_corner_and_station_is_hit_to_the_last_bit(
    legs: list[float], percents: list[int], first: float, largest: float
) -> None:
    corners = np.cumsum([0.0, *legs]).tolist()
    stations = [percent / 100 * corners[-1] for percent in percents]
    control = StepControl(first=min(first, largest), largest=largest, strain=np.inf)
    steps = list(Bar().walk(corners, stations, control))
    travels = [step.travel for step in steps]
    assert [step.number for step in steps] == list(range(1, len(steps) + 1))
    assert all(np.diff([0.0, *travels]) > 0)
    assert {*corners[1:], *(station for station in stations if station > 0)} <= set(travels)
    assert travels[-1] == corners[-1]
    assert np.diff([0.0, *travels]) == pytest.approx([step.size for step in steps], abs=1e-9 * corners[-1])
    assert all(step.size <= largest * (1 + 1e-8) for step in steps)


@given(distance=st.floats(1.0, 50.0))
def test_no_crumb_is_left_before_a_stop(distance: float) -> None:
    """With steps of one all are between one half and one."""
    steps = Bar().walk([0.0, distance], [], StepControl(first=1.0, largest=1.0, strain=np.inf))
    sizes = [step.size for step in steps]
    assert min(sizes) >= 0.5
    assert max(sizes) <= 1.0 + 1e-9
    assert len(sizes) <= np.ceil(distance) + 1


def test_steps_grow_by_a_bounded_factor() -> None:
    steps = list(Bar().walk([0.0, 100.0], [], StepControl(first=1.0, growth=1.5, strain=np.inf)))
    ratios = np.diff(np.log([step.size for step in steps[:-2]]))
    assert ratios == pytest.approx(np.log(1.5))


def test_the_largest_strain_of_a_step_is_aimed_at() -> None:
    bar = Bar(lambda travel: 7.0 * nearly_even(travel))
    steps = list(bar.walk([0.0, 10.0], [], StepControl(first=1e-3, strain=0.3)))
    assert steps[len(steps) // 2].size == pytest.approx(0.3 / 7.0)


def test_strains_in_exact_proportion_let_the_step_grow() -> None:
    steps = list(Bar(lambda travel: travel).walk([0.0, 64.0], [], StepControl(first=1.0, growth=2.0, strain=1e3)))
    assert [step.size for step in steps[:4]] == [1.0, 2.0, 4.0, 8.0]


def test_the_change_of_the_strain_rate_over_a_step_is_aimed_at() -> None:
    """Where the strain grows e-fold over a length L, a step h changes its rate by (1 - exp(-h/L))."""
    length, tolerance = 2.0, 0.1
    bar = Bar(lambda travel: float(np.exp(travel / length)))
    steps = list(bar.walk([0.0, 8.0], [], StepControl(first=0.01, tolerance=tolerance, strain=np.inf)))
    middle = steps[len(steps) // 2].size
    assert 1.0 - np.exp(-middle / length) == pytest.approx(tolerance, rel=5e-3)


@pytest.mark.parametrize(("iterations", "grows"), [(8, True), (9, False)])
def test_a_hard_step_is_followed_by_a_shorter_one(iterations: int, grows: bool) -> None:
    walk = Bar(iterations=iterations).walk([0.0, 100.0], [], StepControl(first=1.0, strain=np.inf))
    first, second = next(walk), next(walk)
    assert (second.size > first.size) == grows


def test_a_stop_on_the_way_does_not_slow_the_walk_down() -> None:
    control = StepControl(first=1.0, growth=1.5, strain=np.inf)
    without = len(list(Bar().walk([0.0, 100.0], [], control)))
    assert len(list(Bar().walk([0.0, 100.0], [9.0], control))) <= without + 1


def test_each_leg_starts_with_the_first_step_and_a_linear_prediction() -> None:
    """After a corner the last increment says nothing about the next."""
    bar = Bar()
    steps = list(bar.walk([0.0, 5.0, 9.0], [3.0], StepControl(first=0.5, strain=np.inf)))
    after_corner = next(step for step in steps if step.travel > 5.0)
    assert (steps[0].size, after_corner.size) == (0.5, 0.5)
    assert bar.calls.count("predict") == 2
    assert bar.calls.count("follow") == len(steps) - 2


def test_the_last_increment_is_followed_in_proportion() -> None:
    bar = Bar()
    steps = list(bar.walk([0.0, 20.0], [], StepControl(first=1.0, strain=np.inf)))
    ends = [step.travel for step in steps[1:]]
    assert bar.guesses == pytest.approx(ends)


def test_a_failed_step_is_rolled_back_halved_and_tried_again() -> None:
    bar = Bar()
    bar.fails = lambda begin, end: end - begin > 0.3
    walk = bar.walk([0.0, 10.0], [], StepControl(first=1.0, strain=np.inf))
    first = next(walk)
    assert bar.calls == ["predict", "fail", "roll back"] * 2 + ["predict", "solve", "commit"]
    assert (first.size, first.travel, first.cutbacks) == (0.25, 0.25, 2)
    assert first.iterations == 3 * 3
    assert next(walk).size == 0.25  # what just failed is not tried again at once


def test_a_first_step_that_was_far_too_long_is_soon_cut_to_where_the_body_is_stiff() -> None:
    bar = Bar()
    bar.fails = lambda begin, end: end - begin > 1e-3
    walk = bar.walk([0.0, 10.0], [], StepControl(first=1.0, stiff=1e-3, strain=np.inf))
    first = next(walk)
    assert (first.size, first.cutbacks) == (1e-3, 2)


def test_a_first_step_that_the_law_would_have_to_cut_small_is_not_even_tried() -> None:
    """Unless it is one that the program chose."""
    bar = Bar()
    bar.substeps = 100
    walk = bar.walk([0.0, 10.0], [], StepControl(first=1.0, stiff=0.01, strain=np.inf))
    first = next(walk)
    assert (first.size, first.iterations) == (0.01, 3)
    assert bar.calls.count("solve") == 1


def test_a_step_that_strains_a_point_too_much_is_not_even_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bar, "largest_strain", lambda bar: bar._target)
    bar = Bar()
    first = next(bar.walk([0.0, 10.0], [], StepControl(first=3.0, strain=np.inf)))
    assert first.size == 0.75
    assert bar.calls.count("solve") == 1


def test_a_body_is_let_move_over_a_step_that_was_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not over one as long as the last, of which a half may do without."""
    bar, moved = Bar(), []

    def relax(problem: Any, solver: Any, largest_strain: float) -> Solution:
        moved.append(bar._target - float(bar.committed.x.array[0]))
        bar.unknown.x.array[0] = bar._target
        return Solution(True, 40, "converged", 0.0)

    monkeypatch.setattr("cosserat_fx.stepping.relax", relax)
    bar.fails = lambda begin, end: begin == 3.0
    steps = list(bar.walk([0.0, 10.0], [], StepControl(first=1.0, stiff=0.1, growth=1.0, strain=np.inf)))
    assert moved == [0.5]
    [cut] = [step for step in steps if step.cutbacks]
    assert (cut.size, cut.cutbacks, cut.travel) == (0.5, 1, 3.5)
    assert cut.iterations == 3 + 3 + 3 + 40


@pytest.mark.parametrize(
    ("pressure", "rolling", "first"),
    [(100e3, 0.0125, 0.0025 * 0.04), (100e3, 0.25, 0.05 * 0.5e-3 / (2 * 0.25)), (10.0, 0.0, None)],
)
def test_a_layers_first_step_shows_its_stiff_response(pressure: float, rolling: float, first: float | None) -> None:
    """0.25 % of shear, or a rotation of 0.05 at a wall, or four times the pressure over the stiffness at e_c."""
    keys = (f"initial.stress={-pressure}", f"walls.top.normal_stress={-pressure}", f"walls.top.rolling={rolling}")
    control = build(scene("medium_rough", *keys), MPI.COMM_SELF).stepper.control
    if first is None:
        critical = SAND.characteristic_void_ratios(pressure).e_c
        first = 4 * pressure / SAND.stiffness_factor(pressure, critical) * 0.04
        assert first < 0.0002 * 0.04
    assert control.first == control.stiff == pytest.approx(first)
    assert control.smallest == pytest.approx(1e-4 * first)


def test_a_step_that_fails_at_the_smallest_size_ends_the_walk() -> None:
    bar = Bar()
    bar.fails = lambda begin, end: end > 2.5
    walk = bar.walk([0.0, 10.0], [], StepControl(first=1.0, smallest=0.01, strain=np.inf))
    steps: list[Step] = []
    with pytest.raises(SteppingError, match=r"the step from 2\.\d* m failed at the smallest size, 0\.01 m: it snapped"):
        steps.extend(walk)
    assert 2.49 <= steps[-1].travel <= 2.5
    assert bar.calls[-2:] == ["fail", "roll back"]
    assert bar.unknown.x.array[0] == bar.committed.x.array[0] == steps[-1].travel


def test_the_smallest_step_is_a_part_of_the_first_unless_it_is_given() -> None:
    assert StepControl(first=1.0).smallest == pytest.approx(1e-4)
    assert StepControl(first=1.0, smallest=0.1).smallest == 0.1
    assert StepControl(first=1.0, stiff=1e-3).smallest == pytest.approx(1e-7)


def test_a_scene_sets_the_aims_of_its_steps_and_leaves_the_default_ones_alone() -> None:
    defaults = build(scene("medium_rough"), MPI.COMM_SELF).stepper.control
    assert (defaults.tolerance, defaults.strain) == (StepControl(first=1.0).tolerance, StepControl(first=1.0).strain)
    control = build(
        scene("medium_rough", "stepping.tolerance=0.03", "stepping.strain=0.1"), MPI.COMM_SELF
    ).stepper.control
    assert (control.tolerance, control.strain) == (0.03, 0.1)


def test_a_walk_ends_after_as_many_steps_as_allowed() -> None:
    walk = Bar().walk([0.0, 10.0], [], StepControl(first=1.0, max_steps=2))
    assert [next(walk).number, next(walk).number] == [1, 2]
    with pytest.raises(SteppingError, match="limit of 2 steps at a travel of"):
        next(walk)


# -- a layer -----------------------------------------------------------------------------------------------------------


def test_a_failed_attempt_leaves_no_trace_in_the_state() -> None:
    """A step of 20 cm fails; what follows is, to the last bit, what follows without it."""
    layers = [build(scene("medium_rough"), MPI.COMM_SELF) for _ in range(2)]
    ends = []
    for layer, try_too_much in zip(layers, (False, True), strict=True):
        problem, solver = layer.problem, layer.stepper.solver
        walk = iter(layer.stepper)
        for _ in range(3):
            travel = next(walk).travel
        if try_too_much:
            before = (problem.committed.x.array.copy(), problem.state.forces_n.copy(), problem.state.e_n.copy())
            problem.apply(0.2)
            problem.impose()
            assert not solver.solve().converged
            problem.roll_back()
            assert np.array_equal(problem.unknown.x.array, before[0])
            after = (problem.committed.x.array, problem.state.forces_n, problem.state.e_n)
            assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
        problem.apply(travel + 1e-4)
        problem.impose()
        assert solver.solve().converged
        problem.commit()
        ends.append((problem.committed.x.array.copy(), problem.state.forces_n.copy(), problem.state.e_n.copy()))
    assert all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))
