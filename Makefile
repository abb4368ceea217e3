# make demo: the full pipeline on a virtual drone.   make test: all but the slow tests.   make test-all: all but those of a night.
# Each creates the environment from the lock first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Also constrains what building the package itself needs.
export PIP_CONSTRAINT := requirements.lock
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Whatever the machine says, Python keeps what it compiles: else each worker rewrites all tests' assertions again, ten seconds of a core.
export PYTHONDONTWRITEBYTECODE :=
# The same versions with the hash of every file, which uv checks; pip cannot for a checkout.
export UV_CONSTRAINT := requirements.hashes
export UV_BUILD_CONSTRAINT := requirements.hashes

# uv takes seconds where pip takes most of a minute, but knows no package index that only pip was told of.
define install
@echo "installing the locked packages into $(VENV) ..."
@$(BIN)/python -m pip install --quiet uv
@VIRTUAL_ENV=$(VENV) $(BIN)/uv pip install --quiet $(2) --editable '.$(1)' $(3) || { echo "uv cannot; pip does, in about a minute ..." \
  && $(BIN)/python -m pip install --quiet --editable '.$(1)' $(3); }
endef

.PHONY: demo extras test test-all night lint docs paper format lock oldest audit release-check clean

demo: $(VENV)/.installed
	$(BIN)/maidenflight demo
	@echo 'To go on: . $(BIN)/activate && maidenflight --help'

# A test that ended its process is begun again by another, which it may end too.
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart 2

test: $(VENV)/.installed-dev
	$(PYTEST) -m 'not slow'

# In one run, so that what a file's tests share is made once.
test-all: $(VENV)/.installed-dev
	$(PYTEST) -m 'not night' --durations 40

# Tests of a night, and a hundred thousand damaged files, other ones every time.
night: $(VENV)/.installed-dev
	$(PYTEST) -m night
	$(PYTEST) --dist load --hypothesis-profile night tests/files/test_damaged_files.py

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

# Packages of extras beside the same editable install: make extras EXTRAS=ulog,onnx
extras: $(VENV)/.installed
	$(call install,[$(EXTRAS)],,)

# The documentation site, in site/; a broken link is an error (with --quiet it would not be). The variable silences an advertisement.
docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Studies of the paper by gradients and by its own PPO, and its table of claims in paper/notes/paper.md: six hours of one core.
# Results that are there are not made again.
RESULTS ?= build/paper
AUTHORS ?= ../shared/data/authors
STUDY = $(BIN)/python paper
TABLES := $(addprefix $(RESULTS)/,gradients/zero_shot/flights.csv gradients/ablations/flights.csv gradients/history.csv \
  PPO/zero_shot/flights.csv PPO/ablations/flights.csv PPO/history.csv PPO/table_2/table_2.csv)
paper: $(TABLES)
	$(STUDY)/claims.py --results "by gradients=$(RESULTS)/gradients" --results "by PPO=$(RESULTS)/PPO" \
	  $(if $(wildcard $(AUTHORS)),--authors $(AUTHORS)) --page paper/notes/paper.md --figure paper/notes/figure_4.svg
$(TABLES): | $(VENV)/.installed-dev
$(RESULTS)/gradients/zero_shot/flights.csv:
	$(STUDY)/figure_4.py -o $(@D)
$(RESULTS)/PPO/zero_shot/flights.csv:
	$(STUDY)/figure_4.py --settings paper/settings/zero_shot_ppo.toml -o $(@D)
$(RESULTS)/gradients/ablations/flights.csv:
	$(STUDY)/ablations.py -o $(@D)
$(RESULTS)/PPO/ablations/flights.csv:
	$(STUDY)/ablations.py --method ppo --seeds 2 --draws 4 -o $(@D)
$(RESULTS)/gradients/history.csv:
	$(STUDY)/history_and_hidden.py --hidden -o $@
$(RESULTS)/PPO/history.csv:
	$(STUDY)/history_and_hidden.py --method ppo --updates 400 --hidden -o $@
$(RESULTS)/PPO/table_2/table_2.csv:
	$(STUDY)/table_2.py --flights 132 $(if $(wildcard $(AUTHORS)),--logs $(AUTHORS)/flights/pwm) -o $(@D)

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(None if (3, 11) <= v < (3, 14) else f"maidenflight needs Python 3.11 to 3.13; this is {v.major}.{v.minor}. Use make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: requirements.lock requirements.hashes pyproject.toml | $(VENV)/bin/python
	$(call install,,,)
	touch $@

$(VENV)/.installed-dev: requirements.lock requirements.hashes pyproject.toml plant/pyproject.toml | $(VENV)/bin/python
	# Tests start many processes, and not every machine lets Python keep what it compiles.
	$(call install,[dev],--compile-bytecode,--editable ./plant)
	$(BIN)/python -m compileall -q src plant/src
	touch $@ $(VENV)/.installed

# Newest versions that fit pyproject.toml, for every supported Python.
COMPILE := $(BIN)/uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 --no-header --no-annotate \
  --no-emit-index-url --no-emit-find-links
lock: $(VENV)/.installed-dev
	UV_CONSTRAINT= $(COMPILE) --upgrade --generate-hashes --output-file requirements.hashes
	UV_CONSTRAINT= $(COMPILE) --constraint requirements.hashes --output-file requirements.lock

# The oldest versions that pyproject.toml allows, and its quick tests with them.
oldest: $(VENV)/.installed-dev
	$(BIN)/uv venv --clear build/oldest
	UV_CONSTRAINT= UV_BUILD_CONSTRAINT= VIRTUAL_ENV=build/oldest $(BIN)/uv pip install --resolution lowest-direct --editable '.[dev]' --editable ./plant
	build/oldest/bin/python -m pytest -n auto --dist loadfile -m 'not slow'

# Known vulnerabilities of the locked versions, as far as PyPI can be asked.
audit: $(VENV)/.installed-dev
	PATH="$(BIN):$$PATH" $(BIN)/python benchmarks/audit.py

# Everything a release is: sdist and wheel, their metadata, the list of parts (SBOM), the changelog's entry; then the demo and the quick tests on the wheel,
# in an environment of its own; of the sdist's sources tests read only the text. A person then runs `uv publish`.
release-check: $(VENV)/.installed-dev
	rm -rf dist build/release && mkdir -p build/release
	grep -q "^## $$($(BIN)/maidenflight --version | sed 's/.* //')$$" CHANGELOG.md
	$(BIN)/uv build --quiet --out-dir dist
	$(BIN)/uv tool run twine check --strict dist/*
	$(BIN)/uv venv --clear --python $(BIN)/python build/release/venv
	VIRTUAL_ENV=build/release/venv $(BIN)/uv pip install --quiet --compile-bytecode "$$(ls dist/*.whl)[dev]" ./plant
	$(BIN)/uv tool run --from cyclonedx-bom cyclonedx-py environment --output-reproducible --output-file dist/maidenflight.cdx.json build/release/venv/bin/python
	cd build/release && venv/bin/maidenflight demo -o run --overwrite
	tar -xzf dist/*.tar.gz -C build/release --strip-components 1
	cd build/release && venv/bin/python -c 'import maidenflight; assert "site-packages" in maidenflight.__file__'
	cd build/release && venv/bin/python -m pytest -n auto --dist loadfile --max-worker-restart 2 -m 'not slow'

clean:
	rm -rf $(VENV) build dist site
