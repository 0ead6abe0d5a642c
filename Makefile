# Set-up, demo, tests and checks. Needs only CPython (3.10 to 3.13; CI runs 3.11) with venv, and make.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
INSTALLED := $(VENV)/.installed
DEMO := runs/demo

.PHONY: help demo test lint docs format benchmark clean

help:
	@echo 'make demo       train 1000 episodes in contact physics, then drive and film an unseen world (about 5 minutes)'
	@echo 'make test       the whole test suite'
	@echo 'make lint       ruff, import-linter, mypy, and figures of the docs against results/'
	@echo 'make docs       the documentation site, into site/'
	@echo 'make format     let ruff rewrite the sources'
	@echo 'make benchmark  speed against the bare engine'
	@echo 'make clean      remove the environment, runs and caches'

# What the demo needs, and no more. Python compiles a module when it is first imported; most of these never are.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, 14))' || \
		{ echo "CPython 3.10 to 3.13 is needed (PyBullet has no wheels for others); set PYTHON=/path/to/python3.11"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --constraint constraints.txt --no-compile --editable .
	@touch $@

$(INSTALLED): $(READY)
	$(BIN)/pip install --constraint constraints.txt --editable '.[dev,docs,log,maps,mujoco,ray,rllib,sb3,sweep,export,baselines,viz,render,robots,ros]'
	@touch $@

demo: $(READY)
	$(BIN)/nnql-bullet train --out $(DEMO) --overwrite
	$(BIN)/nnql-bullet drive $(DEMO) --world cover_10 --seed 4
	$(BIN)/nnql-bullet render $(DEMO)/drives/cover_10-4/trajectory.npz --speed 2
	@echo 'Look at $(DEMO)/learning_curve.png, and at the picture and the video named above.'

test: $(INSTALLED)
	$(BIN)/python -m pytest -n auto --dist worksteal

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache --no-logo
	$(BIN)/mypy
	$(BIN)/python scripts/make_tricycle.py --check
	$(BIN)/python scripts/docs_site/hooks.py --check

docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

benchmark: $(INSTALLED)
	$(BIN)/python scripts/benchmark.py

clean:
	rm -rf $(VENV) runs dist site .pytest_cache .mypy_cache .ruff_cache .hypothesis
