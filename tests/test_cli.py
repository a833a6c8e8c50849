"""The command line, called in this process as the console script calls it."""

import io
import json
import re
import sys
from pathlib import Path

import pytest
from console import BAD_INPUT, DONE, QUICK, STOPPED, Call, assert_refused, listing, quick
from layers import DEMOS, demo
from rich.console import Console

from cosserat_fx import cli, progress
from cosserat_fx._compat import MPI
from cosserat_fx.kernel_time import IN_KERNEL
from cosserat_fx.results import Run, RunFolder, read_run
from cosserat_fx.run import run as run_scene
from cosserat_fx.scene import load_scene
from cosserat_fx.stepping import Step

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
    sizes = summary["sizes"]
    assert (sizes["unknowns"], sizes["cells"], sizes["quadrature_points"]) == (3 * 21, 20, 20)
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
    kept = f"What was computed is in {tmp_path / 'run'}; --resume goes on from there."
    assert outcome.err == f"stopped early: {reason}. {kept}\n"
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
    """The monitor prints each Newton iteration, of which no attempt has a second one; a value may be negative."""
    tried = ("-snes_max_it", "1", "-snes_monitor", "-snes_divergence_tolerance", "-1.0")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick("stepping.min_step=1e-4"), *tried)
    assert "1 SNES Function norm" in outcome.out
    assert "2 SNES Function norm" not in outcome.out


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
        counts = rf"{effect['unknowns'] or ''} +{effect['bytes_per_point'] or ''}"
        share = r"\d+ %" if effect["name"] in IN_KERNEL and effect["choice"] != "off" else ""
        line = rf"^{effect['name']} +{effect['choice']} +{counts} +{share} +{re.escape(effect['reason'])} *$"
        assert re.search(line, outcome.out, re.M)
    assert "243 unknowns, 80 cells, 80 quadrature points" in outcome.out
    expected = r"^expected cost on 1 rank\(s\): about (\d+) steps in (\S+) s, (\S+) s of it constitutive update, \S+ s"
    cost = re.search(expected, outcome.out, re.M)
    assert cost
    assert 0.5 < int(cost[1]) / summary["steps"] < 2
    assert float(cost[3]) < float(cost[2])
    assert 0.1 < float(cost[3]) / summary["seconds"]["constitutive update"] < 10
    [state] = re.findall(r"^memory: (\S+) MB of state, \d+ non-zeros, \S+ MB of factors; about", outcome.out, re.M)
    sizes = summary["sizes"]
    memory = sizes["quadrature_points"] * sizes["bytes_per_quadrature_point"]
    assert float(state) == pytest.approx(memory / 1e6, rel=1e-2)


def test_check_knows_plane_bodies(call: Call) -> None:
    outcome = call("check", DEMOS / "biaxial.toml")
    assert (outcome.status, outcome.err) == (DONE, "")
    assert re.search(r"^dimension +plane .* plane strain *$", outcome.out, re.M)
    assert re.search(r"^hourglass stabilisation +on +8 .*Q1R", outcome.out, re.M)
    assert "2907 unknowns, 896 cells, 896 quadrature points" in outcome.out


def test_check_refuses_what_only_the_mesh_can_tell(call: Call) -> None:
    outcome = call("check", DEMOS / "biaxial.toml", "--set", "boundaries.left.pressure=1e3", "--set", "points={}")
    assert_refused(outcome, "the body can move rigidly")


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
