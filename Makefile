# make demo   the medium rough layer, from its scene file to the figures
# make test   the test suite
# make lint   ruff and mypy
# make bench  the performance, measured: docs/performance.md
# make docs   the figures and tables of the documentation, made anew
# make reliability   those of its pages on stability, reliability and requested accuracy, which take hours
# Each makes the environment .venv first, once, with DOLFINx and everything else from PyPI.
# PYTHON=/path/to/python chooses the Python to make it with.

ifneq (4.0,$(firstword $(sort 4.0 $(MAKE_VERSION))))
$(error GNU make $(MAKE_VERSION) is too old, 4.0 or newer is needed: try apt install make)
endif

.ONESHELL:
.SHELLFLAGS := -euc
.SILENT:
.PHONY: install demo test lint bench docs reliability clean

# Small problems want ranks, not threads; on one machine MPI has no network card to look for.
export OMP_NUM_THREADS ?= 1
export UCX_TLS ?= self,sm,tcp

scene := layer_medium_rough

demo: .venv/.complete
	.venv/bin/cosserat-fx run demos/$(scene).toml --out runs/$(scene) --overwrite
	echo "The figures are in runs/$(scene)/figures."

test: .venv/.complete
	.venv/bin/python -m pytest

lint: .venv/.complete
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy

performance := kernel_speed newton_floor overhead external_operator ranks growth effects_price prediction

bench: .venv/.complete
	.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps dolfinx-external-operator
	for part in $(performance); do
	  .venv/bin/python benchmarks/$$part.py --out runs/performance
	  sed -i -e "/^<!-- $$part -->$$/,/^<!-- end -->$$/{//!d}" -e "/^<!-- $$part -->$$/r runs/performance/$$part.md" docs/performance.md
	done
	cp runs/performance/*.png docs/figures/
	echo "docs/performance.md is up to date; tables and figures are in runs/performance."

# What the pages show and a run can make anew.
docs: demo bench
	cp runs/$(scene)/figures/layer.png docs/figures/$(scene).png
	.venv/bin/python benchmarks/layer_accuracy.py --out runs/layer_accuracy
	cp runs/layer_accuracy/*.png docs/figures/
	sed -i '/^<!-- tables -->$$/q' docs/layer-accuracy.md
	cat runs/layer_accuracy/tables.md >> docs/layer-accuracy.md
	.venv/bin/cosserat-fx study demos/$(scene).toml --out runs/study_$(scene)
	for part in cost rates where; do
	  cp runs/study_$(scene)/figures/$$part.png docs/figures/study_$$part.png
	done
	sed -n '/^## Reference/,/^## Turned alone/{/^## Turned/!s/^## /### /;/^## Turned/!p}' runs/study_$(scene)/study.md > runs/study_$(scene)/page.md
	sed -i -e '/^<!-- study -->$$/,/^<!-- end -->$$/{//!d}' -e '/^<!-- study -->$$/r runs/study_$(scene)/page.md' docs/study.md
	.venv/bin/python benchmarks/element_study.py --out runs/element_study
	cp runs/element_study/*.png docs/figures/
	sed -i '/^<!-- tables -->$$/q' docs/elements.md
	cat runs/element_study/tables.md >> docs/elements.md
	.venv/bin/cosserat-fx run demos/biaxial.toml --out runs/biaxial --overwrite
	cp runs/biaxial/figures/state_04.png docs/figures/biaxial.png
	.venv/bin/python benchmarks/biaxial_accuracy.py --out runs/biaxial_accuracy
	cp runs/biaxial_accuracy/*.png docs/figures/
	sed -i '/^<!-- tables -->$$/q' docs/biaxial.md
	cat runs/biaxial_accuracy/tables.md >> docs/biaxial.md
	.venv/bin/python benchmarks/plane_demos.py --out runs/plane_demos
	cp runs/plane_demos/*.png docs/figures/
	cp runs/plane_demos/shear_box_4/figures/state_03.png docs/figures/shear_box.png
	for page in shear-box rough-strip; do
	  sed -i -e "/^<!-- $$page.md -->$$/,/^<!-- end -->$$/{//!d}" -e "/^<!-- $$page.md -->$$/r runs/plane_demos/$$page.md" docs/$$page.md
	done
	for strip in very medium; do
	  cp runs/plane_demos/rough_strip_$${strip}_rough/figures/state_03.png docs/figures/rough_strip_$${strip}_rough.png
	done

# What the pages on stability, reliability and requested accuracy show; hours on two cores, and gone on with where it was interrupted.
reliability: .venv/.complete
	.venv/bin/python benchmarks/stability_atlas.py --out runs/stability_atlas
	cp runs/stability_atlas/*.png docs/figures/
	sed -i '/^<!-- tables -->$$/q' docs/stability.md
	cat runs/stability_atlas/tables.md >> docs/stability.md
	.venv/bin/python benchmarks/accuracy_promise.py --out runs/accuracy_promise
	cp runs/accuracy_promise/accuracy_promise.png docs/figures/
	sed -i -e "/^<!-- accuracy_promise -->$$/,/^<!-- end -->$$/{//!d}" -e "/^<!-- accuracy_promise -->$$/r runs/accuracy_promise/accuracy_promise.md" docs/accuracy.md
	.venv/bin/python benchmarks/checkpoint_cost.py --out runs/checkpoint_cost
	.venv/bin/python benchmarks/faults.py --out runs/faults
	.venv/bin/python benchmarks/fuzz.py --cases 6000 --out runs/fuzz
	.venv/bin/python benchmarks/soak.py --out runs/soak
	cp runs/soak/soak.png docs/figures/
	for part in checkpoint_cost faults fuzz soak; do
	  sed -i -e "/^<!-- $$part -->$$/,/^<!-- end -->$$/{//!d}" -e "/^<!-- $$part -->$$/r runs/$$part/tables.md" docs/reliability.md
	done

install: .venv/.complete

clean:
	rm -rf .venv build *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find cosserat_fx forms tests demos -name __pycache__ -prune -exec rm -rf {} +

# Python's own word on whether an environment can be made with it: silent, or one sentence on what is missing.
define check_machine
import os, platform, shlex, shutil, subprocess, sys, sysconfig
from importlib.util import find_spec

python = f"python{sysconfig.get_python_version()}"
libc, libc_version = platform.libc_ver()
compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
preprocess = [*compiler, "-E", "-I" + sysconfig.get_path("include"), "-x", "c", "-o", os.devnull, "-"]

if (sys.platform, platform.machine()) != ("linux", "x86_64"):
    sys.exit(f"The DOLFINx wheel is for Linux on x86-64, this is {platform.system()} on {platform.machine()}: use the Dockerfile.")
if libc != "glibc" or [int(part) for part in libc_version.split(".")] < [2, 34]:
    sys.exit(f"The DOLFINx wheel needs glibc 2.34 or newer, this is {libc or 'another C library'} {libc_version}: use the Dockerfile.")
if not find_spec("ensurepip"):
    sys.exit(f"{sys.executable} cannot make virtual environments: try apt install {python}-venv.")
if not shutil.which(compiler[0]):
    sys.exit(f"A C compiler ({compiler[0]}) was not found, DOLFINx compiles its forms with it: try apt install gcc libc6-dev.")
if subprocess.run(preprocess, input=b"#include <Python.h>", capture_output=True).returncode:
    sys.exit(f"{compiler[0]} cannot include Python.h of {sys.executable}: try apt install {python}-dev libc6-dev.")
endef
export check_machine

# The last line of the recipe writes the mark of a complete environment. Without the mark it is made anew, so an
# interrupted installation never stays; when only pyproject.toml is newer, it is brought up to date.
.venv/.complete: pyproject.toml
	for python in $${PYTHON:-python3 python3.12 python3.13 python3.14 "$$(uv python find '>=3.12' 2>/dev/null || :)"}; do
	  "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null && break
	  python=
	done
	if [ -z "$$python" ]; then
	  echo >&2 "Python 3.12 or newer is needed and was not found ($${PYTHON:-python3} is $$($${PYTHON:-python3} --version 2>/dev/null || echo absent)): get one from your system's packages, with pyenv install 3.12 or with uv python install 3.12, or name one with make PYTHON=/path/to/python."
	  exit 1
	fi
	"$$python" -c "$$check_machine"
	if [ -e $@ ]; then rm $@; else rm -rf .venv; "$$python" -m venv .venv; fi
	echo "Installing DOLFINx and everything else from PyPI into .venv, which takes a few minutes the first time ..."
	.venv/bin/python -m pip install --quiet --quiet --disable-pip-version-check --editable '.[dolfinx,dev]'
	touch $@
