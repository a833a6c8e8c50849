"""One rank fails and the others do not: all end, with one message, and the run goes on afterwards."""

from pathlib import Path

import pytest
from faults import assert_nothing_lost, launch

IMPATIENTLY = "import cosserat_fx.parallel; cosserat_fx.parallel.PATIENCE = 0.5"
OBSERVE = "cosserat_fx.output.layer_observation:LayerObserver.row"
IMPORTS = "from cosserat_fx.results import OutputError\nfrom cosserat_fx.scene import SceneError"
FAULTS = {
    "a scene that one rank cannot read": (
        "on_call('cosserat_fx.cli:load_scene', 1, throw(SceneError('it is not here')), rank=1)",
        "cosserat-fx: it is not here",
    ),
    "no memory in the set-up": (
        "on_call('cosserat_fx.problem:Problem.__init__', 1, throw(MemoryError('no memory')), rank=1)",
        "cosserat-fx: internal error on rank 1: MemoryError: no memory",
    ),
    "an error in what PETSc calls": (
        "on_call('cosserat_fx.problem:Problem.update', 20, throw(ZeroDivisionError('no number')), rank=1)",
        "cosserat-fx: internal error on rank 1: ZeroDivisionError: no number",
    ),
    "no room on the first rank": (
        f"on_call('{OBSERVE}', 2, throw(OutputError('no room')))",
        "cosserat-fx: internal error on rank 0: OutputError: no room",
    ),
    "SIGKILL within a checkpoint": (
        "on_call('cosserat_fx.checkpoints.file:_told', 4, send(9), rank=1)",
        None,
    ),
    "Ctrl-C after all else is done": (
        "on_call('cosserat_fx.recorder:Recorder.finish', 1, throw(KeyboardInterrupt), rank=1)",
        "cosserat-fx: interrupted",
    ),
}
"""What happens on one of two ranks, and what is told."""


def test_all_end_and_go_on(tmp_path: Path, undisturbed_on_two: Path) -> None:
    """One run suffers each of them in turn; ranks that wait for ever fail the test by the clock."""
    folder = tmp_path / "run"
    for fault, (injected, message) in FAULTS.items():
        process = launch(folder, ranks=2, before=f"{IMPATIENTLY}\n{IMPORTS}\n{injected}")
        assert process.returncode not in (0, 3), f"{fault}: {process.stderr}"
        told = [line for line in process.stderr.splitlines() if line.startswith("cosserat-fx: ")]
        assert told == ([] if message is None else [message]), f"{fault}: {process.stderr}"
    process = launch(folder, ranks=2)
    assert process.returncode == 0, process.stderr
    assert_nothing_lost(folder, undisturbed_on_two)


@pytest.mark.parametrize(
    ("fault", "status", "message"),
    [
        (
            "on_call('cosserat_fx.output.layer_fields:Series.__init__', 1, throw(OutputError('no room')))",
            2,
            "cosserat-fx: no room",
        ),
        (
            "on_call('cosserat_fx.output.folder:RunFolder.append_history', 2, throw(TypeError('no row')))",
            1,
            "cosserat-fx: internal error on rank 0: TypeError: no row",
        ),
    ],
    ids=["foreseen", "unforeseen"],
)
def test_what_the_first_rank_cannot_do_for_all_is_told_once(
    fault: str, status: int, message: str, tmp_path: Path
) -> None:
    """It ends all ranks alike, without any of them having to end the others."""
    process = launch(tmp_path / "run", ranks=2, before=f"{IMPORTS}\n{fault}")
    assert process.returncode == status
    assert [line for line in process.stderr.splitlines() if line.startswith("cosserat-fx: ")] == [message]
    assert process.stderr.count("Traceback") == (status == 1)
