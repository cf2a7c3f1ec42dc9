# make demo: environment, install, one run. make check: lint and types.
# make test: all tests. make quick: without whole runs, processes and browsers; within a minute.
# make adversary: 2000 bad and extreme inputs, signals and kills; COUNT=200 SEED=1 for others.
# make docs: the documentation, in site/; EXECUTE_NOTEBOOKS=false: notebooks without outputs.
# make pictures: those of the README; needs Chromium (on Debian: apt-get install chromium).
# make release: source distribution and wheel in dist/, both checked.
# make lowest: the unit tests with the lowest versions that pyproject.toml names.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test quick check adversary pictures release clean

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
	$(BIN)/lint-imports --no-logo --no-cache

COUNT ?= 2000
SEED ?= 0
adversary: $(VENV)/.installed-dev
	cd tests && ../$(BIN)/python -m adversary --count $(COUNT) --seed $(SEED)

pictures: $(VENV)/.installed-dev
	$(BIN)/drake-nonstop pictures --out docs/pictures

# Both distributions, checked: the quick tests in the unpacked source, a run by the installed wheel.
release: $(VENV)/.installed-dev
	$(BIN)/pip install --quiet --editable '.[release]'
	rm -rf dist build/release
	$(BIN)/python -m build --outdir dist
	$(BIN)/twine check --strict dist/*
	mkdir -p build/release
	tar -xf dist/*.tar.gz -C build/release
	cd build/release/drake_nonstop-* && OPENBLAS_NUM_THREADS=1 \
	  "$(CURDIR)/$(BIN)/python" -m pytest -q -n 2 --dist worksteal -m "not slow"
	$(PYTHON) -m venv build/release/venv
	build/release/venv/bin/pip install --quiet dist/*.whl
	cd build/release && venv/bin/drake-nonstop run quintic --set simulation_duration=1

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

# In an environment of its own, with the oldest Python that is found.
LOWEST := .venv-lowest
.PHONY: lowest
lowest: $(LOWEST)/.installed
	OPENBLAS_NUM_THREADS=1 $(LOWEST)/bin/pytest -n 2 --dist worksteal -m "not slow"

# The lowest versions for which there are wheels: older ones may not compile with a new Python.
$(LOWEST)/.installed: pyproject.toml
	rm -rf $(LOWEST)
	for python in python3.10 python3.11 python3.12 python3.13 $(PYTHON); do \
	  $$python -c 'import ensurepip' 2>/dev/null && exec $$python -m venv $(LOWEST); done; exit 1
	$(LOWEST)/bin/pip install --quiet uv==0.13.9
	$(LOWEST)/bin/uv pip compile --quiet --python $(LOWEST) --no-build --extra dev pyproject.toml \
	  --resolution lowest-direct --output-file $(LOWEST)/requirements.txt
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST) --requirements $(LOWEST)/requirements.txt
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST) --no-deps --editable .
	@touch $@

clean:
	rm -rf $(VENV) $(LOWEST) out

# The documentation, in site/: open site/index.html.
.PHONY: docs
docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

$(VENV)/.installed-docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --editable '.[docs]'
	@touch $@
