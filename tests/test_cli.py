"""The command line, called in this process as the console script calls it."""

import io
import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from layers import NOTHING_TO_LOOK_AT, PRESSURE, demo
from rich.console import Console

from cosserat_fx import cli, progress
from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.results import Run, RunFolder, read_run
from cosserat_fx.run import run as run_scene
from cosserat_fx.scene import load_scene
from cosserat_fx.stepping import Step

DONE, BAD_INPUT, STOPPED = 0, 2, 3
QUICK = [*NOTHING_TO_LOOK_AT, "walls.top.shear_displacement=2e-4", "output.profiles_at=[2e-4]"]


class Outcome(NamedTuple):
    status: int
    out: str
    err: str


Call = Callable[..., Outcome]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Iterator[Call]:
    """Calls the program with arguments; gives back its exit status and what it, PETSc included, printed."""

    def call_with(*arguments: object) -> Outcome:
        capfd.readouterr()
        monkeypatch.setattr(sys, "argv", ["cosserat-fx", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert isinstance(end.value.code, int | None)
        return Outcome(end.value.code or 0, *capfd.readouterr())

    yield call_with
    options = PETSc.Options("cosserat_")
    for name in options.getAll():
        options.delValue(name)


def quick(*overrides: str) -> list[str]:
    return [argument for override in (*QUICK, *overrides) for argument in ("--set", override)]


def listing(folder: Path) -> dict[Path, tuple[int, bytes]]:
    """Every file below a folder with its time and contents, every folder with its time."""
    return {path: (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else b"") for path in folder.rglob("*")}


# -- run ---------------------------------------------------------------------------------------------------------------


def test_a_run_leaves_its_folder_and_says_so(call: Call, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "run"
    outcome = call("run", demo("medium_rough"), "--out", out, *quick("output.fields=true"))
    assert (outcome.status, outcome.err) == (DONE, "")
    run = read_run(out)
    assert run.summary["status"] == "done"
    steps, iterations = run.summary["steps"], run.summary["newton_iterations"]
    assert f"done: {steps} steps, {iterations} Newton iterations, 0 cutbacks; see {out}\n" in outcome.out
    assert {path.name for path in out.iterdir()} == {"run.json", "history.csv", "profiles.csv", "fields"}
    assert {path.name for path in (out / "fields").iterdir()} == {"layer.pvd", "layer_0000.vtu", "layer_0001.vtu"}


def test_the_summary_holds_what_the_run_was(call: Call, tmp_path: Path) -> None:
    call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick("geometry.cells=20"))
    summary = read_run(tmp_path / "run").summary
    given = load_scene(demo("medium_rough"), [*QUICK, "geometry.cells=20"])
    assert summary["scene"] == given.as_dict()
    assert summary["ranks"] == 1
    assert summary["sizes"] == {
        **{"unknowns": 3 * 21, "cells": 20, "quadrature_points": 20},
        "bytes_per_quadrature_point": summary["sizes"]["bytes_per_quadrature_point"],
    }
    assert {"cosserat_fx", "python", "dolfinx", "petsc", "mpi", "numba", "numpy"} <= set(summary["versions"])
    assert {"set-up", "constitutive update", "strains", "Jacobian assembly", "whole run"} <= set(summary["seconds"])


def test_an_earlier_run_is_replaced_on_demand_only(call: Call, tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert call("run", demo("medium_rough"), "--out", out, *quick()).status == DONE
    first = listing(tmp_path)
    refused = call("run", demo("medium_rough"), "--out", out, *quick())
    assert refused.status == BAD_INPUT
    assert "--overwrite" in refused.err
    assert listing(tmp_path) == first
    assert call("run", demo("very_rough"), "--out", out, *quick(), "--overwrite").status == DONE
    assert read_run(out).summary["title"] == "Plane shearing under a very rough wall"


def test_a_run_that_stops_early_ends_with_three_and_its_reason(call: Call, tmp_path: Path) -> None:
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick("stepping.max_steps=1"))
    assert outcome.status == STOPPED
    reason = read_run(tmp_path / "run").summary["reason"]
    assert reason.startswith("the run reached its limit of 1 steps")
    assert outcome.err == f"stopped early: {reason}. What was computed is in {tmp_path / 'run'}.\n"
    assert "done" not in outcome.out


def test_warnings_are_printed(call: Call, tmp_path: Path) -> None:
    small = quick("walls.top.shear_displacement=0.02", "effects.finite_strain=false")
    outcome = call("run", demo("very_rough"), "--out", tmp_path / "run", *small)
    assert outcome.status == DONE
    [warning] = read_run(tmp_path / "run").summary["warnings"]
    assert outcome.err == f"warning: {warning}\n"


def test_a_folder_that_breaks_off_under_a_run_stops_it(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk, say: that is no bad input, and what is there stays."""
    append = RunFolder.append_history

    def fill(self: RunFolder, row: dict[str, float]) -> None:
        if row["step"] == 2:
            self.history.unlink()
            self.history.mkdir()
        append(self, row)

    monkeypatch.setattr(RunFolder, "append_history", fill)
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick())
    assert outcome.status == STOPPED
    assert "history.csv: cannot be " in outcome.err
    assert "Traceback" not in outcome.err


# -- bad input ---------------------------------------------------------------------------------------------------------

FRACTIONS = f"walls.top={{f_u=0.8, f_r=0.1, f_s=0.2, shear_displacement=0.03, normal_stress={-PRESSURE}}}"
BAD_KEYS = {
    "an unknown key": ("geometry.cell=80", "geometry.cell = 80: unknown key, did you mean cells?"),
    "a wrong type": ("geometry.cells=many", 'geometry.cells = "many": must be a whole number'),
    "a negative height": ("geometry.height=-0.04", "geometry.height = -0.04: must be a finite number greater than 0"),
    "zero cells": ("geometry.cells=0", "geometry.cells = 0: must be a whole number of at least 1"),
    "too dense": ("initial.void_ratio=0.4", "initial.void_ratio = 0.4: must be greater than e_d = 0.472797"),
    "too loose": ("initial.void_ratio=1.2", "less than e_i = 1.11246"),
    "tension": ("initial.stress=100e3", "initial.stress = 100000.0: must be a finite number less than 0"),
    "e_d0 above e_c0": ("material.e_d0=0.9", "material.e_d0 = 0.9: must be"),
    "a bracket h_i below zero": ("material.alpha=2.0", "material.alpha = 2.0: must"),
    "wall fractions": (FRACTIONS, "walls.top.f_u = 0.8: must make f_u + f_r + f_s = 1, but the sum is 1.1"),
    "profiles beyond the end": ("output.profiles_at=[0.04]", "output.profiles_at[0] = 0.04: must lie within"),
    "a bad override": ("geometry.cells", '"geometry.cells": an override must read key.path=value'),
    "an option that PETSc refuses": ("solver.petsc={snes_type='guess'}", "solver.petsc: PETSc says: "),
}


def assert_refused(outcome: Outcome, message: str) -> None:
    """Exit status 2 and one line, without a traceback."""
    assert outcome.status == BAD_INPUT
    assert message in outcome.err
    assert re.fullmatch(r"cosserat-fx: .+\n", outcome.err)
    assert outcome.out == ""


@pytest.mark.parametrize("case", BAD_KEYS)
def test_a_bad_scene_is_refused_with_one_message_and_nothing_written(case: str, call: Call, tmp_path: Path) -> None:
    override, message = BAD_KEYS[case]
    (tmp_path / "bystander").write_text("stays")
    before = listing(tmp_path)
    assert_refused(call("run", demo("medium_rough"), "--out", tmp_path / "run", "--set", override), message)
    assert listing(tmp_path) == before


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "scene.toml: cannot be read as a scene file: No such file"), ("[geometry\n", "scene.toml: not valid TOML")],
)
def test_a_bad_file_is_refused(command: str, content: str | None, message: str, call: Call, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    if content is not None:
        file.write_text(content)
    before = listing(tmp_path)
    assert_refused(call(command, file, *(["--out", tmp_path / "run"] if command == "run" else [])), message)
    assert listing(tmp_path) == before


def test_several_faults_are_told_together(call: Call, tmp_path: Path) -> None:
    faults = ("--set", "geometry.cells=0", "--set", "geometry.height=-1.0")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *faults)
    assert outcome.status == BAD_INPUT
    assert len(outcome.err.splitlines()) == 2
    assert outcome.err.count("cosserat-fx: ") == 1


def test_a_folder_that_is_no_run_is_left_alone(call: Call, tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    before = listing(tmp_path)
    for more in ([], ["--overwrite"]):
        outcome = call("run", demo("medium_rough"), "--out", tmp_path / "thesis", *quick(), *more)
        assert_refused(outcome, "thesis: holds something other than a run")
        assert listing(tmp_path) == before


def test_an_output_folder_may_be_no_file_and_lie_below_none(call: Call, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("stays")
    before = listing(tmp_path)
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "file", *quick())
    assert_refused(outcome, "file: exists and is not a folder")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "file" / "below", *quick())
    assert_refused(outcome, "is not a folder")
    assert listing(tmp_path) == before


@pytest.fixture
def no_privileges() -> Iterator[None]:
    """Root may write everywhere; for the test it becomes nobody."""
    if os.getuid() != 0:
        yield
        return
    nobody = 65534
    os.setresuid(nobody, nobody, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)


@pytest.mark.usefixtures("no_privileges")
@pytest.mark.parametrize("out", ["/usr/run", "/proc/run"])
def test_a_folder_that_may_not_be_written_is_refused(out: str, call: Call) -> None:
    outcome = call("run", demo("medium_rough"), "--out", out, *quick())
    assert_refused(outcome, f"output folder {out}: ")
    assert re.search("no permission to write in|cannot be written", outcome.err)
    assert not Path(out).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--colour", "red"], "--colour: unknown option; options for PETSc have a single dash"),
        (["another.toml"], "another.toml: unexpected argument; a run takes one scene"),
    ],
)
def test_what_a_run_does_not_know_is_refused(arguments: list[str], message: str, call: Call, tmp_path: Path) -> None:
    assert_refused(call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick(), *arguments), message)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", demo("medium_rough")], "--out"),
        (["check", demo("medium_rough"), "--colour"], "--colour"),
        (["fly"], "fly"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_refused(arguments: list[object], message: str, call: Call) -> None:
    outcome = call(*arguments)
    assert outcome.status == BAD_INPUT
    assert message in outcome.err
    assert "Traceback" not in outcome.err


def test_without_arguments_the_commands_are_listed(call: Call) -> None:
    outcome = call("--help")
    assert outcome.status == DONE
    assert all(command in outcome.out for command in ("run", "check", "plot", "info"))


def test_an_error_nobody_foresaw_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(folder: Path) -> list[Path]:
        raise ZeroDivisionError

    monkeypatch.setattr("cosserat_fx.plots.draw_all", broken)
    monkeypatch.setattr(sys, "argv", ["cosserat-fx", "plot", "somewhere"])
    with pytest.raises(ZeroDivisionError):
        cli.main()


# -- options for PETSc -------------------------------------------------------------------------------------------------


def test_options_with_one_dash_go_to_petsc(call: Call, tmp_path: Path) -> None:
    """One Newton iteration is not enough; the monitor prints each of them; a value may be negative."""
    tried = ("-snes_max_it", "1", "-snes_monitor", "-snes_divergence_tolerance", "-1.0")
    coarse = quick("stepping.min_step=1e-4")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *coarse, *tried)
    assert outcome.status == STOPPED
    assert "diverged max it" in outcome.err
    assert "1 SNES Function norm" in outcome.out


def test_options_of_the_scene_go_to_petsc_and_the_command_line_before_them(call: Call, tmp_path: Path) -> None:
    scene = quick("solver.petsc={snes_max_it=1, snes_monitor=''}", "stepping.min_step=1e-4")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *scene, "-snes_max_it", "20")
    assert outcome.status == DONE
    assert "1 SNES Function norm" in outcome.out


def test_options_of_one_run_are_forgotten_in_the_next(call: Call, tmp_path: Path) -> None:
    monitored = call("run", demo("medium_rough"), "--out", tmp_path / "first", *quick(), "-snes_monitor")
    plain = call("run", demo("medium_rough"), "--out", tmp_path / "second", *quick())
    assert "SNES Function norm" in monitored.out
    assert "SNES Function norm" not in plain.out


def test_a_refusal_of_petsc_during_the_run_stops_it(call: Call, tmp_path: Path) -> None:
    """It looks for a solver of equations only when it factorises for the first time."""
    solver = ("-pc_factor_mat_solver_type", "abacus")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick(), *solver)
    assert outcome.status == STOPPED
    assert outcome.err.startswith("stopped early: PETSc says: ")
    assert "abacus" in outcome.err


# -- progress ----------------------------------------------------------------------------------------------------------


def test_progress_in_a_log_file_is_plain_lines(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.0)
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick())
    lines = re.findall(
        r"^step (\d+): ([\d.]+) of 0.2 mm \((\d+) %\), \d+ iterations, [\d.]+ steps/s, about \d+ s left$",
        outcome.out,
        re.MULTILINE,
    )
    assert [int(step) for step, _, _ in lines] == list(range(1, read_run(tmp_path / "run").summary["steps"] + 1))
    assert lines[-1][1:] == ("0.2", "100")
    assert "\x1b" not in outcome.out


def test_a_log_file_gets_a_line_now_and_then_and_one_in_the_end(call: Call, tmp_path: Path) -> None:
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick())
    assert len(re.findall(r"^step \d+: ", outcome.out, re.MULTILINE)) == 1


def test_progress_on_a_terminal_is_a_bar() -> None:
    terminal = Console(file=io.StringIO(), force_terminal=True, width=100)
    with progress.RunProgress(terminal, 0.03) as bar:
        bar.report(Step(7, 0.015, 1e-3, 4, 0))
    assert isinstance(terminal.file, io.StringIO)
    painted = re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", terminal.file.getvalue())
    assert "15.00 mm" in painted
    assert "50%" in painted
    assert re.search(r"step 7, [\d.]+ steps/s, 4 its", painted)


def test_the_python_interface_is_silent(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run_scene(load_scene(demo("medium_rough"), QUICK), tmp_path / "run", comm=MPI.COMM_SELF)
    assert capfd.readouterr() == ("", "")


# -- the other commands ------------------------------------------------------------------------------------------------


def test_check_tells_effects_sizes_and_cost_and_writes_nothing(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, default_runs: dict[str, Run]
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = call("check", demo("medium_rough"))
    assert (outcome.status, outcome.err) == (DONE, "")
    assert list(tmp_path.iterdir()) == []
    summary = default_runs["medium_rough"].summary
    for effect in summary["effects"]:
        assert re.search(rf"^{effect['name']} +{effect['choice']} +{re.escape(effect['reason'])} *$", outcome.out, re.M)
    assert "243 unknowns, 80 cells, 80 quadrature points" in outcome.out
    expected = r"^expected cost: about (\d+) steps, (\S+) s of constitutive update on one rank, (\S+) MB of state$"
    cost = re.search(expected, outcome.out, re.M)
    assert cost
    assert 0.5 < int(cost[1]) / summary["steps"] < 2
    assert 0.1 < float(cost[2]) / summary["seconds"]["constitutive update"] < 10
    sizes = summary["sizes"]
    memory = sizes["quadrature_points"] * sizes["bytes_per_quadrature_point"]
    assert float(cost[3]) == pytest.approx(memory / 1e6, rel=1e-2)


def test_check_takes_overrides(call: Call) -> None:
    outcome = call("check", demo("medium_rough"), "--set", "geometry.cells=10", "--set", "walls.top.rolling=0.0")
    assert "33 unknowns, 10 cells, 10 quadrature points" in outcome.out
    assert_refused(call("check", demo("medium_rough"), "--set", "geometry.cells=0"), "geometry.cells = 0")


def test_plot_draws_again(call: Call, tmp_path: Path) -> None:
    out = tmp_path / "run"
    call("run", demo("medium_rough"), "--out", out, *quick())
    assert not (out / "figures").exists()
    outcome = call("plot", out)
    assert (outcome.status, outcome.err) == (DONE, "")
    drawn = [out / "figures" / name for name in ("history.png", "profiles.png", "layer.png")]
    assert outcome.out.split() == [str(file) for file in drawn]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in drawn)


def test_plot_refuses_what_is_no_run(call: Call, tmp_path: Path) -> None:
    assert_refused(call("plot", tmp_path), "not a run")
    assert list(tmp_path.iterdir()) == []


def test_info_prints_the_versions_that_a_run_keeps(call: Call, default_runs: dict[str, Run]) -> None:
    outcome = call("info")
    told = dict(line.split(maxsplit=1) for line in outcome.out.splitlines())
    assert told == json.loads(json.dumps(default_runs["very_rough"].summary["versions"]))
