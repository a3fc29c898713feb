# Everything one types; `make` alone lists it. Each target does the set-up that it needs and that
# is missing: tools/set_up.py says how that is known.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

SET_UP := tools/set_up.sh
IN_ENVIRONMENT := source ./setup.bash;

# The interpreter to make the environment of; without it the best one that is found.
export PYTHON

# What somebody set for another Python is not for the commands here. A sourced ROS 2 is found by it.
unexport PYTHONHOME PYTHONSTARTUP PYTHONOPTIMIZE PYTHONINSPECT PYTHONEXECUTABLE PYTHONPLATLIBDIR \
    PYTHONWARNINGS PYTHONSAFEPATH PYTHONCASEOK PYTHONVERBOSE PYTHONBREAKPOINT
# Without bytecode kept, each of the many processes that a run starts compiles all it imports.
unexport PYTHONDONTWRITEBYTECODE
ifndef ROS_DISTRO
unexport PYTHONPATH
endif

.PHONY: help
help:  ## what there is
	@echo "make TARGET"
	@sed -n 's/^\([a-z]*\):.*## /  \1\t/p' Makefile | expand -t 9

.PHONY: setup
setup:  ## the Python environment .venv, ROS 2 included (PYTHON=python3.12 chooses the Python)
	@$(SET_UP) environment

.PHONY: build
build:  ## that, and the packages of the workspace; then `source setup.bash`
	@$(SET_UP) workspace

.PHONY: demo
demo: build  ## one experiment with three schemes, recorded and compared: out/demo/report.html
	$(IN_ENVIRONMENT) mfpcc run steady_750_2 --scheme mbpcc --scheme mfpcc --scheme mls_mfpcc \
	    --out out/demo --force

.PHONY: sweeps
sweeps: build  ## that, and what `mfpcc sweep` and `mfpcc tune` need: pyarrow, Dask, Optuna
	@$(SET_UP) sweeps

# One test more than the smallest machine has cores: a fifth of their time is waiting for processes.
.PHONY: test
test:  ## all tests, three at a time; with ARGS='-k wire' those that you name
	@$(SET_UP) workspace development
	$(IN_ENVIRONMENT) python -m pytest --numprocesses 3 --dist worksteal $(ARGS)

.PHONY: bench
bench:  ## every speed figure, beside its reference, measured now
	@$(SET_UP) workspace development
	$(IN_ENVIRONMENT) python bench $(ARGS)

.PHONY: fresh
fresh:  ## from an empty folder and home: demo, demo again, all tests; the time of each step
	@"$$($(SET_UP) --which)" tools/fresh.py

.PHONY: docs
docs: build  ## docs/reference.md, written from the code
	$(IN_ENVIRONMENT) python tools/reference.py

# Simulated time of the soak (min).
SOAK_MINUTES ?= 60

.PHONY: leaderboard
leaderboard: sweeps  ## docs/leaderboard.md, anew: every scheme tuned and judged; a quarter of an hour
	rm -rf out/leaderboard
	$(IN_ENVIRONMENT) mfpcc tune --budget 30 --out out/leaderboard
	cp out/leaderboard/leaderboard.md docs/leaderboard.md

.PHONY: soak
soak: build  ## the drive without rest: lost periods, faults, memory (SOAK_MINUTES=10 is shorter)
	$(IN_ENVIRONMENT) python bench/soak.py --minutes $(SOAK_MINUTES) $(ARGS)

# Only the packages of it that are used: others of those it names come without a wheel.
MUTANTS := build/.mutants

.PHONY: mutants
mutants:  ## small changes of the numeric core, and whether the tests notice (ARGS='--sample 40 search')
	@$(SET_UP) workspace development
	@$(IN_ENVIRONMENT) uv pip install --quiet --no-deps --require-hashes --only-binary :all: \
	    --target $(MUTANTS) --requirements requirements/mutants.txt
	$(IN_ENVIRONMENT) PYTHONPATH="$(MUTANTS)$${PYTHONPATH:+:$$PYTHONPATH}" \
	    python -W ignore tools/mutants.py $(ARGS)

.PHONY: lint
lint:  ## ruff and mypy
	@$(SET_UP) development
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

.PHONY: clean
clean:  ## remove what setup and build made; bags/ and out/ stay
	rm -rf .venv build install log .set-up.lock .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find src test tools bench config -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
