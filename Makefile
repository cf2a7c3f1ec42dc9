# make demo: environment, install, one run.
# make check: lint, types, imports between folders, and limits of what tests may grow to.
# Three tiers of tests:
# make quick: the units, in a minute at most.
# make test: what a change has to pass, in some minutes.
# make nightly: all the rest: studies, both engines on everything, browsers, notebooks, signals and
#   kills, claims on speed, `make docs adversary mutants`, `make lowest TESTS=`.
#   make sample: one test of each class of them, and one of the mutants.
# make adversary: bad and extreme inputs, and signals: COUNT=200 examples of each property, SEED=0.
# make mutants: which faults the tests catch: chosen ones, and DRAWN=120 of the seed SEED=0.
# make golden: writes golden numbers that changed, and lists them; see tests/golden.
# make docs: the documentation, in site/; EXECUTE_NOTEBOOKS=false: notebooks without outputs.
# make pictures: those of the README; needs Chromium (on Debian: apt-get install chromium).
# make release: source distribution and wheel in dist/, both checked.
# make lowest: the quick tests with the lowest versions that pyproject.toml names;
#   TESTS=: those of `make test`; PYTHON_OF_LOWEST=python3.12: with that Python.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test quick nightly sample check adversary mutants golden pictures release clean

demo: $(VENV)/.installed
	$(BIN)/drake-nonstop run quintic
	@echo "Open out/quintic/replay.html in a browser; figures are in out/quintic/figures."

# Two workers, each of one thread: NumPy's own would stand in each other's way.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 2 --dist worksteal
UNITS := $(addprefix tests/,mechanics model planning systems blocks scenario)

test: $(VENV)/.installed-dev
	$(PYTEST)

quick: $(VENV)/.installed-dev
	$(PYTEST) $(UNITS) -m "not slow and not nightly"

# One after the other, whatever fails before, so that a night tells all.
nightly: $(VENV)/.installed-dev
	status=0; \
	$(PYTEST) -m nightly || status=1; \
	for part in docs adversary "lowest TESTS=" mutants; do $(MAKE) $$part || status=1; done; \
	exit $$status

sample: $(VENV)/.installed-dev
	$(PYTEST) -m nightly --sample 1
	cd tests && ../$(BIN)/python -m mutants --drawn 0 --file mechanics/wrench.py --brief

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo --no-cache
	$(BIN)/python tests/counts.py

COUNT ?= 200
SEED ?= 0
DRAWN ?= 120
adversary: $(VENV)/.installed-dev
	ADVERSARY_COUNT=$(COUNT) $(PYTEST) tests/adversary -m "nightly or not nightly" \
	  --hypothesis-seed=$(SEED)

mutants: $(VENV)/.installed-dev
	cd tests && ../$(BIN)/python -m mutants --drawn $(DRAWN) --seed $(SEED)

golden: $(VENV)/.installed-dev
	cd tests && ../$(BIN)/python -m golden

pictures: $(VENV)/.installed-dev
	$(BIN)/python -m tests.benchmarks pictures --out docs/pictures

# Both distributions, checked, each in an environment of its own: the quick tests in the unpacked
# source, and a run by the installed wheel.
release: $(VENV)/.installed-dev
	$(BIN)/pip install --quiet --editable '.[release]'
	rm -rf dist build/release
	$(BIN)/python -m build --outdir dist
	$(BIN)/twine check --strict dist/*
	mkdir -p build/release
	tar -xf dist/*.tar.gz -C build/release
	mv build/release/drake_nonstop-* build/release/source
	$(PYTHON) -m venv build/release/of_source
	build/release/of_source/bin/pip install --quiet --editable 'build/release/source[dev]'
	cd build/release/source && OPENBLAS_NUM_THREADS=1 \
	  ../of_source/bin/pytest -n 2 --dist worksteal $(UNITS) -m "not slow and not nightly"
	$(PYTHON) -m venv build/release/of_wheel
	build/release/of_wheel/bin/pip install --quiet dist/*.whl
	cd build/release && of_wheel/bin/drake-nonstop run quintic --set simulation_duration=1

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "$(PYTHON) is older than Python 3.10: set PYTHON to a newer one" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "Debian ships venv apart: apt-get install python3-venv, then again" >&2; exit 1; }

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --editable '.[dev,mutants]'
	@touch $@ $(VENV)/.installed

# In an environment of its own, with the oldest Python that is found.
LOWEST := .venv-lowest
PYTHON_OF_LOWEST ?= python3.10 python3.11 python3.12 python3.13 $(PYTHON)
TESTS ?= $(UNITS) -m "not slow and not nightly"
.PHONY: lowest
lowest: $(LOWEST)/.installed
	OPENBLAS_NUM_THREADS=1 $(LOWEST)/bin/pytest -n 2 --dist worksteal $(TESTS)

# The lowest versions for which there are wheels: older ones may not compile with a new Python.
$(LOWEST)/.installed: pyproject.toml
	rm -rf $(LOWEST)
	for python in $(PYTHON_OF_LOWEST); do \
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
	cd tests && ../$(BIN)/python -m site_pages ../site

$(VENV)/.installed-docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --editable '.[docs]'
	@touch $@
