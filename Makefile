# Everything a newcomer needs: `make demo`, `make test`. Python 3.11 or newer and make are enough.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   ?= .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.installed
SAMPLE ?= 10
SEED   ?= 1

# compiled once and not by each of the hundreds of processes that the tests start
export PYTHONDONTWRITEBYTECODE :=

CORES        := $(shell getconf _NPROCESSORS_ONLN)
WORKERS      ?= $(shell echo $$(($(CORES) + 1)))
LIVE_WORKERS ?= $(shell echo $$((2 * $(CORES))))
BY_FILE      := --dist loadfile --no-loadscope-reorder
# one worker more than cores, since some tests wait for a timeout; twice as many for live runs, which mostly wait

# every line and branch of what keeps the rig safe
COVERED := --cov-branch --cov-fail-under=100 --cov-report=term-missing:skip-covered \
	$(addprefix --cov=hil.,core.supervisor core.interlocks core.overshoot core.live_levels core.inflow_watch core.dry_watch wire.frame_check wire.command_sender)

.PHONY: help setup demo test test-socketcan test-long long mutants lint unit live benchmarks docs docs-serve lock clean

help:            ## show this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/'

setup: $(READY)  ## make .venv with the pinned packages and this project in it

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: make PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-compile --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	$(BIN)/python -m hil.core.diagnosis.glr
	$(BIN)/python -m hil.core.identification
	@touch $@

demo: $(READY)   ## the paper's experiment: table 3 beside the paper's, then the fault with each detector
	@$(BIN)/hil demo

test: lint unit  ## all checks and tests

lint: $(READY)   ## style, types, architecture, words
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy --num-workers $(CORES)
	$(BIN)/lint-imports
	$(BIN)/python -m tools.words

unit: export OPENBLAS_NUM_THREADS := 1
unit: $(READY)   ## the test suite: on all cores, then live runs beside each other, then those that measure time, alone
	$(BIN)/python -m pytest -n $(WORKERS) $(BY_FILE) tests/safety tests/wire $(COVERED)
	$(BIN)/python -m pytest -n $(WORKERS) $(BY_FILE) -m "not live and not long and not socketcan" --ignore=tests/safety --ignore=tests/wire
	$(BIN)/python -m pytest -n $(LIVE_WORKERS) --dist loadgroup --no-loadscope-reorder -m "live and not timing and not long" tests/live
	$(BIN)/python -m pytest -m "timing and not long" tests/live

test-socketcan: $(READY)  ## the tests on the kernel's CAN buses, in a guest where this kernel has none
	@$(BIN)/python -m tools.guest test

test-long: long mutants  ## both: ten minutes on two cores, with make -j2

long: export OPENBLAS_NUM_THREADS := 1
long: $(READY)   ## simulated hours, hundreds of pairs of faults, examples, blocks of the documentation
	$(BIN)/python -m pytest -n $(CORES) --dist worksteal -m long

# nice: the long tests beside it, some of which run in real time, come first
mutants: $(READY)  ## every small change of the safety modules, and a sample of those elsewhere, must fail a test
	nice -n 5 $(BIN)/python -m tools.mutants
	nice -n 5 $(BIN)/python -m tools.mutants --sample $(SAMPLE) --seed $(SEED)

benchmarks: $(READY)  ## timings as ratios, for docs/reference/benchmarks.md
	$(BIN)/python -m tools.benchmark

docs: $(READY)   ## the documentation site in site/, any warning is an error
	$(BIN)/python -m tools.reference
	$(BIN)/zensical build --clean --strict

docs-serve: $(READY)  ## the same on http://localhost:8000, built again at each change
	$(BIN)/python -m tools.reference
	$(BIN)/zensical serve

lock: $(READY)   ## pin again what pyproject.toml asks for (needs uv)
	uv pip compile pyproject.toml --group dev --group docs --all-extras --universal --python-version 3.11 --generate-hashes \
	  --no-header --no-emit-index-url --upgrade --quiet --output-file requirements.lock

clean:           ## remove what can be made again
	rm -rf $(VENV) dist site .cache .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find hil -name '*.nb[ci]' -delete
