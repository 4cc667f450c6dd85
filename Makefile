# `make run`: everything from a fresh checkout to a first shape model. `make test`: the checks.
# Only what is missing is installed; a second call goes straight to work.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# Debian packages: pymeshlab needs the first two, PyVista's figures off screen the others.
SYSTEM_PACKAGES := libgl1 libopengl0 libegl1 libosmesa6
TEST_PACKAGES   := chromium
STUDY ?= luna16

.PHONY: run test test-slow coverage audit lint docs package install install-dev system system-test clean

run: install
	$(BIN)/workflow run $(STUDY)

test: install-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile

# Real runs killed at every write, and ten thousand damaged files a reader: hours.
test-slow: install-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m slow -s
	OMP_NUM_THREADS=1 $(BIN)/python tools/fuzz.py --count 10000

# Which lines the tests reach. Processes that a test starts are not counted.
coverage: install-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile --cov=ssm_pipeline --cov-report=term:skip-covered

# Known vulnerabilities in the pinned versions.
audit: install-dev
	$(BIN)/python -m pip install --quiet pip-audit
	$(BIN)/pip-audit --requirement constraints.txt --no-deps --disable-pip

lint: install-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: install-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

package: install-dev
	rm -rf build/package
	$(BIN)/python -m build --outdir build/package
	$(BIN)/twine check --strict build/package/*

install: system $(VENV)/.installed

install-dev: system system-test $(VENV)/.installed-dev

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e .
	touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev]'
	touch $@ $(VENV)/.installed

system:
	@sh tools/install_system_packages.sh $(SYSTEM_PACKAGES)

system-test:
	@sh tools/install_system_packages.sh $(TEST_PACKAGES)

clean:
	rm -rf $(VENV)
