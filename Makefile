# Everything from a fresh clone, with Python 3.11+ (and its venv module) and make: `make demo`, `make test`.
# Where packages come from is uv's and pip's own configuration; nothing here names an index.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
CORES = $$($(BIN)/python -c 'import os; print(os.cpu_count())')
# Bytecode is kept, whatever the environment says: dozens of processes would compile the same libraries and tests.
unexport PYTHONDONTWRITEBYTECODE
# One thread of BLAS in each process.
PYTEST = OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --dist worksteal --numprocesses

.PHONY: help demo test quick ready check lint imports types fuzz docs wheel results bench lock clean

help:
	@echo "make demo    install, then reconstruct and evaluate a synthetic clip into out/demo"
	@echo "make test    install, then run all tests, on every core"
	@echo "make quick   those that are quick and need no browser"
	@echo "make check   lint, layering and types"
	@echo "make fuzz    change valid inputs of every reader for MINUTES=5, and keep what goes wrong as a test"
	@echo "make docs    build the documentation as a site: site/index.html"
	@echo "make wheel   build dist/, install the wheel into a fresh environment without the clone, and use it there"
	@echo "make results DEXYCB=DIR YCB=DIR [OTHER=DIR]   measure the tables of a release"
	@echo "make bench   measure speed, into results/"
	@echo "make lock    recompile requirements.lock from pyproject.toml"
	@echo "make clean   remove the virtual environment and all caches"

demo: $(VENV)/warm
	$(BIN)/getagrip demo --out out/demo

# One process more than there are cores, since some tests wait. The quick ones do not.
test: ready
	$(PYTEST) $$(( $(CORES) + 1 ))

quick: ready
	$(PYTEST) $(CORES) -m 'not slow and not browser'

ready: $(VENV)/installed
	@$(MAKE) --no-print-directory --jobs=2 $(VENV)/warm $(VENV)/collected

check: lint imports types

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

imports: $(VENV)/installed
	$(BIN)/lint-imports --no-cache

types: $(VENV)/installed
	$(BIN)/mypy

MINUTES ?= 5
fuzz: $(VENV)/warm
	PYTHONPATH=tests $(BIN)/python -m fuzz --minutes $(MINUTES)

# Anew each time, since commands and docstrings are in it. A link that leads nowhere is an error. GETAGRIP_SITE is the
# address that the site will have, if known: pages name it as theirs, and the wheel links there.
docs: $(VENV)/installed
	rm -rf site
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going -b html -d $(VENV)/doctrees --fresh-env docs site

# By the locked back end; pages of an index show README's links where GETAGRIP_REPOSITORY or the CI names the repository.
wheel: $(VENV)/installed
	rm -rf dist
	$(BIN)/python -m hatchling build -d dist
	$(BIN)/python scripts/try_wheel.py dist/*.whl

results: $(VENV)/warm
	$(BIN)/python -m benchmarks.release $(DEXYCB) $(YCB) $(if $(OTHER),--other $(OTHER))

bench: $(VENV)/installed
	$(BIN)/python -m benchmarks

# uv is quick; pip steps in where only pip is configured with an index. Only wheels, pinned and hash-checked; the package itself is linked, built by the locked back end.
$(VENV)/installed: requirements.lock pyproject.toml | $(BIN)/python
	$(PIP) install uv
	$(BIN)/uv pip install --quiet --python $(BIN)/python --require-hashes --only-binary :all: -r requirements.lock \
		|| $(PIP) install --require-hashes --only-binary :all: -r requirements.lock
	$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "getagrip needs Python 3.11 or later; name one: make PYTHON=python3.12 ..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# Compiled once here, not by every worker, into the user's cache. A failure is reported but stops nothing: kernels are also compiled when first used.
$(VENV)/warm: $(VENV)/installed
	$(BIN)/getagrip doctor || echo "getagrip doctor found something wrong; see above" >&2
	@touch $@

# The tests' bytecode, with the checks of shapes in the package, and the kernels that doctor's clip does not need.
$(VENV)/collected: $(VENV)/installed
	@$(BIN)/python -m pytest -m compiles -qq > /dev/null || echo "tests cannot be collected, or kernels not compiled" >&2
	@touch $@

lock:
	@test -x $(BIN)/python || $(MAKE) $(BIN)/python
	@test -x $(BIN)/uv || $(PIP) install uv
	$(BIN)/uv pip compile pyproject.toml --group dev --universal --python-version 3.11 --generate-hashes --no-build \
		--no-header --no-annotate --no-emit-index-url --no-emit-find-links --upgrade --quiet --output-file requirements.lock

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
