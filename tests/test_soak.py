"""A long run leaves nothing behind step by step: no open file, no object of PETSc or Python, no memory.

Ten thousand steps are for benchmarks/soak.py.
"""

import json
from pathlib import Path

import pytest
from ranks import on_ranks

_SOAK = """
import json, sys
from dataclasses import asdict
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import soaking
steps, cycles, every = map(int, sys.argv[4:])
seen = soaking.soak(getattr(soaking, sys.argv[2])(steps, cycles), Path(sys.argv[3]), every)
print(json.dumps(asdict(seen)))
"""


@pytest.mark.parametrize(("kind", "steps", "cycles"), [("layer", 150, 2), ("plane", 40, 2)])
def test_many_steps_leave_nothing_behind(kind: str, steps: int, cycles: int, tmp_path: Path) -> None:
    """From the end of the first cycle to that of the last, with checkpoints and output as in any run."""
    every = steps // 2
    seen = json.loads(on_ranks(1, _SOAK, Path(__file__).parent, kind, tmp_path / "run", steps, cycles, every))
    first = seen["step"].index(steps)
    assert seen["step"][-1] >= cycles * steps - every
    for name in ("handles", "petsc"):
        assert seen[name][first]
        assert all(it == seen[name][first] for it in seen[name][first:]), name
    # The bar that shows the progress remembers up to a thousand steps.
    assert seen["python"][-1] - seen["python"][first] <= 1.5 * (seen["step"][-1] - seen["step"][first])
    assert seen["resident"][-1] < 1.01 * seen["resident"][first]
    assert seen["answer"].endswith("all points admissible")
