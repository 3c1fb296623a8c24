# `make demo` and `make test` set up what each needs in .venv, once, and go. `make help` lists the rest.

PYTHON ?= $(shell for python in python3 python3.12 python3.11; do \
	$$python -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' 2>/dev/null && \
	echo $$python && break; done)
ARGS ?=
VENV := .venv
BIN := $(VENV)/bin
# tests/conftest.py says which tests share a worker.
PARALLEL := --dist loadgroup
# One worker more than cores: the tests of real nodes mostly wait, and come first.
ALL := --numprocesses $$(($$(nproc) + 1)) --no-loadscope-reorder
# The linters are tests, too (tests/repository/test_lint.py), so that they run beside the others.
# Hundreds of processes start in the tests; each would compile every module again.
unexport PYTHONDONTWRITEBYTECODE
FAST := --numprocesses auto --ignore=tests/system/ros --hypothesis-profile=fast -m 'not slow and not ros and not browser'
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
# uv takes a fifth of pip's time. Only pip knows the index and the build of torch that its configuration names.
UV := $(BIN)/uv pip
# Of every file of a release, so that each platform's wheel passes.
HASHES := $(UV) compile --quiet --no-deps --generate-hashes --no-annotate --custom-compile-command 'make lock'
# An editable installation is made again when a requirement, an entry point or a package has changed.
REQUIREMENTS := setup.py setup.cfg pyproject.toml constraints.txt $(wildcard cablesense_*/__init__.py training/__init__.py)

.DEFAULT_GOAL := help
.PHONY: help demo test test-fast lint setup site reference tutorial gallery models messages lock verify man dist clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## /  make \1	/p' $(MAKEFILE_LIST)

demo: $(VENV)/.demo build/compiled  ## a live picture of an arm being pushed; ARGS='--headless' prints a table instead
	@$(BIN)/cablesense demo $(ARGS)

test: setup build/mypy build/compiled-all  ## style, types, dependencies between packages, and all tests on all cores; ARGS go to pytest
	@$(BIN)/python -m pytest $(PARALLEL) $(ALL) $(ARGS)

test-fast: setup build/compiled-all  ## the tests that take milliseconds: no nodes, no browser, nothing slow
	@$(BIN)/python -m pytest $(PARALLEL) $(FAST) $(ARGS)

lint: setup build/mypy  ## style, types and dependencies between packages
	@failed=0; \
	$(BIN)/ruff check || failed=1; \
	$(BIN)/ruff format --check || failed=1; \
	$(BIN)/mypy || failed=1; \
	$(BIN)/lint-imports --no-logo || failed=1; \
	exit $$failed

# Statics are compiled once a machine; many processes at once would each take several times as long.
# Numba does not see that a module of which code is in another module's has changed.
build/compiled: $(shell grep -l '^@compiled' cablesense_sim/*.py)
	@mkdir -p build
	@rm -f cablesense_sim/__pycache__/*.nbi cablesense_sim/__pycache__/*.nbc
	@$(BIN)/python -c 'import numpy as np; from cablesense_sim.arm import open_arm; from cablesense_sim.build import mechanism_of; from cablesense_sim.equilibrium import solve_equilibrium; solve_equilibrium(mechanism_of(open_arm("cdsm")), np.zeros(8))'
	@touch $@

# What the default arm does without.
build/compiled-all: build/compiled
	@$(BIN)/python -c 'from cablesense_sim.arm import open_arm; from cablesense_sim.dynamics import ArmQuasiStatics; ArmQuasiStatics(open_arm("cdsm_friction"))'
	@touch $@

setup: $(VENV)/.all  ## everything that developing needs, in .venv

site: setup build/mypy  ## the documentation as a site, in build/site
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

reference: setup  ## docs/ros_reference.md again, its tables of topics and parameters from the code
	@$(BIN)/python .ci/reference > build/ros_reference.md
	@mv build/ros_reference.md docs/ros_reference.md

tutorial: setup build/mypy  ## docs/tutorial.md again, with what its commands print; some minutes
	@$(BIN)/python .ci/tutorial

gallery: setup build/mypy  ## draws the pictures of docs/gallery.md again
	@PYTHONPATH=build/mypy $(BIN)/python .ci/gallery

models: setup  ## makes every bundled model again
	@CABLESENSE=$(BIN)/cablesense config/models/train.sh

messages: $(VENV)/.demo  ## compiles the message of the topic ~/estimate into .venv; needs gcc
	@$(BIN)/python cablesense_msgs/compile_for_wheels.py

lock: setup  ## writes versions of .venv to constraints.txt, their files' hashes beside it, and to NOTICE what is copyleft
	@mkdir -p build
	@$(BIN)/python .ci/lock > build/constraints.txt
	@$(HASHES) build/constraints.txt --output-file build/constraints.hashes.txt >/dev/null
	@mv build/constraints.txt build/constraints.hashes.txt .
	@$(BIN)/python .ci/notice > build/NOTICE
	@mv build/NOTICE NOTICE

verify: | $(BIN)/python  ## installs constraints.txt apart, refusing every file whose hash is not in constraints.hashes.txt
	@$(BIN)/python -m venv --clear build/verify
	@build/verify/bin/python -m pip install --quiet --disable-pip-version-check --no-compile \
		--no-deps --require-hashes --requirement constraints.hashes.txt
	@rm -r build/verify
	@echo 'Every file has a hash of constraints.hashes.txt.'

man: $(VENV)/.demo  ## the manual page of `cablesense`, from its help texts, in man/
	@mkdir -p man build
	@$(BIN)/python .ci/man > build/cablesense.1
	@mv build/cablesense.1 man/cablesense.1

dist: setup  ## wheels and source distributions of a release, in dist/
	@rm -rf dist && mkdir dist
	@$(BIN)/python .ci/release dist

clean:  ## takes away .venv and what was built
	@rm -rf $(VENV) build dist man install log *.egg-info

$(VENV)/.demo: $(REQUIREMENTS) | $(BIN)/python
	@echo 'Installing what the demo needs (up to a minute, once) …'
	@$(INSTALL) uv && $(UV) install --quiet --python $(BIN)/python --constraint constraints.txt --editable '.[demo]' || \
	PYTHONWARNINGS=ignore $(INSTALL) --editable '.[demo]'
	@touch $@

$(VENV)/.all: $(VENV)/.demo
	@echo 'Installing what the tests need (some minutes, once: torch is large) …'
	@PYTHONWARNINGS=ignore $(INSTALL) --editable '.[demo,train,gap,dev,docs,benchmarks]'
	@touch $@

$(BIN)/python:
	@test -n '$(PYTHON)' || { \
	echo 'CableSense needs Python 3.11 or 3.12, and found neither; name one: make PYTHON=/path/to/python3.12' >&2; \
	exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' || { \
	echo 'CableSense needs Python 3.11 or 3.12, and $(PYTHON) is not; name one: make PYTHON=/path/to/python3.12' >&2; \
	exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	echo '$(PYTHON) cannot make virtual environments: apt-get install python3-venv' >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)

# mypy wants a folder of the name that a package is imported by
build/mypy:
	@mkdir -p $@
	@ln -sfn ../../training $@/cablesense_training
