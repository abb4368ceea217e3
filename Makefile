# make demo: the full pipeline on a virtual drone.   make test: all but the slow tests.   make test-all: all.
# Each creates the environment from the lock first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Also constrains what building the package itself needs.
export PIP_CONSTRAINT := requirements.lock
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test test-slow test-all lint docs format lock clean

demo: $(VENV)/.installed
	$(BIN)/maidenflight demo
	@echo 'To go on: . $(BIN)/activate && maidenflight --help'

# XLA compiles in half the time without its optimizations; the slow tests compile as users do.
test: $(VENV)/.installed-dev
	JAX_DISABLE_MOST_OPTIMIZATIONS=1 $(BIN)/python -m pytest -n auto --dist loadfile -m 'not slow'

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m slow --durations 20

test-all: test test-slow

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

# The documentation site, in site/; a broken link is an error (with --quiet it would not be). The variable silences an advertisement.
docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(None if (3, 11) <= v < (3, 14) else f"maidenflight needs Python 3.11 to 3.13; this is {v.major}.{v.minor}. Use make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "installing the locked packages into $(VENV), about a minute ..."
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.installed-dev: requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "installing the locked packages into $(VENV), about a minute ..."
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@ $(VENV)/.installed

# Newest versions that fit pyproject.toml, for every supported Python.
lock:
	uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 --upgrade --no-header --no-annotate \
	  --no-emit-index-url --no-emit-find-links --output-file requirements.lock

clean:
	rm -rf $(VENV) build dist site
