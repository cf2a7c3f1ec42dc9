# make demo: environment, install, one run. make check: lint and types.
# make test: all tests. make quick: without whole runs, processes and browsers; within a minute.
# make pictures: those of the README; needs Chromium (on Debian: apt-get install chromium).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test quick check pictures clean

demo: $(VENV)/.installed
	$(BIN)/drake-nonstop run quintic
	@echo "Open out/quintic/replay.html in a browser; figures are in out/quintic/figures."

# Two workers, each of one thread: NumPy's own would stand in each other's way.
test: $(VENV)/.installed-dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 2 --dist worksteal

quick: $(VENV)/.installed-dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 2 --dist worksteal -m "not slow"

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

pictures: $(VENV)/.installed-dev
	$(BIN)/drake-nonstop pictures --out examples/pictures

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "$(PYTHON) is older than Python 3.10: set PYTHON to a newer one" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "Debian ships venv apart: apt-get install python3-venv, then again" >&2; exit 1; }

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --editable '.[dev]'
	@touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) out
