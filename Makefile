# Every target sets itself up: a virtual environment in .venv, once.
#
#   make demo        a small search on this machine, and its report
#   make quick       lint and the unit tests that need no cluster, in a minute and a half
#   make test        style, types, import rules and all quick tests
#   make coverage    the lines that the quick tests run; compiled kernels and processes count less
#   make test-slow   the tests that take minutes or run at full scale
#   make test-robustness   bad files, attacks over HTTP, kills: some 20 minutes
#   make counts      files, lines, imports and shared names of the package
#   make bench       figures: how long things take here
#   make docs        the pages of docs/ as a site in site/, without a network
#   make lint        style, types and import rules alone
#
# Another interpreter: make demo PYTHON=/usr/bin/python3.12 (3.11 or newer).

# Tests start hundreds of processes; without stored bytecode each would compile what it imports.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PYTHON ?=

.DEFAULT_GOAL := help
.PHONY: help demo quick test coverage test-slow test-robustness counts bench docs kernels-breast kernels-others lint format constraints clean

help:
	@sed -n 's/^#   //p' Makefile

demo: $(READY)
	$(BIN)/palpate run examples/demo.yaml --study runs/demo
	$(BIN)/palpate report runs/demo

# Files that take most of the time of their folders.
LONG := workers/body/mesh/test_adaptive_mesh.py workers/body/mesh/test_real_breast.py \
	workers/comparison/test_exposure.py \
	workers/comparison/observation/test_gap_open.py workers/comparison/observation/test_noise.py

quick: lint
	$(BIN)/pytest -q -m "not slow" -n 2 --dist loadfile tests/workers/body tests/workers/comparison tests/service/search tests/storage $(LONG:%=--ignore=tests/%)

test: $(READY)
	@$(MAKE) --no-print-directory -j 2 kernels-breast lint kernels-others
	$(BIN)/pytest -m "not slow" -n 2 --dist loadfile --no-loadscope-reorder

coverage: $(READY)
	$(BIN)/pytest -q -m "not slow" -n 2 --dist loadfile --cov

test-slow: $(READY)
	$(BIN)/pytest -m slow

test-robustness: $(READY)
	$(BIN)/python -W ignore -m tests.robustness.run --seed 1

counts: $(READY)
	@$(BIN)/python -m tests.counts

bench: $(READY)
	$(BIN)/palpate bench --nodes 5000,20000,90000 --spacing 1,0.5,0.2

docs: $(READY)
	$(BIN)/mkdocs build --strict

# Compiled once, rather than by both processes of the tests.
kernels-breast kernels-others: kernels-%: $(READY)
	$(BIN)/python -m tests.kernels $*

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# After a change of the dependencies in pyproject.toml.
constraints: $(READY)
	$(BIN)/pip freeze --exclude-editable > constraints.txt

clean:
	rm -rf $(VENV) site .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

# The stamp is written last, so an installation cut short is taken up again.
$(READY): pyproject.toml constraints.txt
	@found=; if [ ! -x $(BIN)/python ]; then \
	    for python in $(or $(PYTHON),python3.11 python3 python3.12 python3.13 python3.14); do \
	        if "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	            found="$$python"; break; \
	        fi; \
	    done; \
	    if [ -z "$$found" ]; then \
	        echo "Palpate needs Python 3.11 or newer and found none$(if $(PYTHON), at $(PYTHON))." >&2; \
	        echo "Name one: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)" >&2; \
	        exit 1; \
	    fi; \
	    echo "Setting up $(VENV) with $$found (a minute or two, once)"; \
	    "$$found" -m venv $(VENV) || { rm -rf $(VENV); exit 1; }; \
	fi
	@$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e ".[dev]"
	@touch $(READY)
