# `make demo` and `make test` set up everything they need.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

# Two jobs at a time, one core each.
BESIDE := hydra/launcher=joblib hydra.launcher.n_jobs=2

.PHONY: help demo conditions tail test test-all lint types docs wheel results clean

help:  ## list what can be made
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(VENV)/.installed  ## train on a small gridworld for a few minutes, then print the scores
	$(BIN)/python -m zipf.train experiment=demo
	$(BIN)/python -m zipf.report runs/demo

conditions: $(VENV)/.installed-dev  ## every agent on the same gridworld, three seeds each: some hours on 2 cores
	OMP_NUM_THREADS=1 $(BIN)/python -m zipf.train -m sweep=demo $(BESIDE)
	$(BIN)/python -m zipf.report runs/demo_conditions

tail: conditions  ## parts for learning the tail, on the larger environments, too: some days on 2 cores
	OMP_NUM_THREADS=1 $(BIN)/python -m zipf.train -m sweep=tail $(BESIDE)
	$(BIN)/python -m zipf.report runs/

test: $(VENV)/.installed-dev  ## run the tests
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

test-all: test  ## run the tests, and the slow tier: every level, trainings, clusters
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m slow

lint: $(VENV)/.installed-dev  ## check style and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev  ## check types
	$(BIN)/mypy

docs: $(VENV)/.installed-dev  ## build the documentation into site/; open site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

wheel: $(VENV)/.installed-dev  ## build the wheel into dist/
	$(BIN)/python -m build --wheel

results: $(VENV)/.installed-dev  ## write docs/record.md and the tables of RESULTS.md from the files in results/
	$(BIN)/python -m zipf.report results window=own claims=true record=docs/record.md
	$(BIN)/python scripts/write_tables.py

clean:  ## remove the virtual environment and what was built; runs are kept
	rm -rf $(VENV) dist build site

# What users need, and what tests and a maintainer need besides.
$(VENV)/.installed: pyproject.toml constraints.txt
$(VENV)/.installed-dev: EXTRAS := [dev]
$(VENV)/.installed-dev: pyproject.toml constraints.txt

$(VENV)/.installed $(VENV)/.installed-dev:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; say which: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".$(EXTRAS)"
	touch $@
