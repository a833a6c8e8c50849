"""What holds before DOLFINx is there, and that the version is one number everywhere."""

import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import cosserat_fx

ROOT = Path(__file__).parents[1]
WITHOUT_DOLFINX = "import sys; sys.modules['dolfinx'] = None\n"


def run_without_dolfinx(code: str) -> subprocess.CompletedProcess[str]:
    """Runs code in a fresh interpreter in which DOLFINx cannot be imported."""
    return subprocess.run([sys.executable, "-c", WITHOUT_DOLFINX + code], capture_output=True, text=True, cwd=ROOT)


def test_the_package_imports_without_dolfinx() -> None:
    result = run_without_dolfinx("import cosserat_fx; print(cosserat_fx.__version__)")
    assert result.stdout.strip() == cosserat_fx.__version__, result.stderr


def test_a_missing_dolfinx_is_told_with_both_ways_to_install_it() -> None:
    result = run_without_dolfinx("import cosserat_fx._compat")
    assert result.returncode != 0
    message = result.stderr[result.stderr.rindex("ImportError: ") :]
    assert "apt install python3-dolfinx" in message
    assert 'pip install "cosserat-fx[dolfinx]"' in message
    assert "dolfinx-solver-real" in message


def test_the_wheel_extra_of_the_message_exists() -> None:
    wanted = [line for line in importlib.metadata.requires("cosserat-fx") or [] if 'extra == "dolfinx"' in line]
    assert [re.split("[<>=;]", line)[0].strip() for line in wanted] == ["dolfinx-solver-real"]


def test_the_version_is_the_same_everywhere() -> None:
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    latest = re.search(r"^## \[(\d\S*)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert cited is not None
    assert latest is not None
    assert cosserat_fx.__version__ == importlib.metadata.version("cosserat-fx") == cited[1] == latest[1]


def test_the_forms_of_this_tree_are_the_package_s() -> None:
    code = "import cosserat_fx.forms; print(cosserat_fx.forms.__file__)"
    here = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert Path(here.stdout.strip()).resolve() == ROOT / "forms" / "__init__.py"
