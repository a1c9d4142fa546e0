# Needs only Python 3.11 or newer with pip; everything else goes into .venv.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed
# what a target needs beside what running needs: an extra of pyproject.toml
TEST := .venv/with-test
DOCS := .venv/with-docs
CHECK := .venv/with-check
DEV := .venv/with-dev
PACKAGES := package models inference chains apps
MODULES := $(sort $(shell find $(PACKAGES) -type f -not -path '*/__pycache__/*'))
# Shows all that pyenv has, where there is one.
NOX := PYENV_VERSION=$$(pyenv versions --bare 2>/dev/null | paste -sd :) $(BIN)/nox

.PHONY: help install demo docs docs-links test test-slow test-all test-versions test-newest test-processors test-oldest-processor test-seeds check constraints bench reproduce results fuzz dist clean
.DELETE_ON_ERROR:

help:
	@echo "make install                the command rsmcm, in .venv/bin"
	@echo "make demo                   track the people in a built-in scene"
	@echo "make docs                   the documentation, in docs/_build/html: every warning is an error"
	@echo "make docs-links             whether the addresses in it are there, which needs a network"
	@echo "make test                   quick tests: five to fifteen minutes on two cores"
	@echo "make test-slow              slow tests: kills, streams, threads, accuracy, fuzzing, experiments"
	@echo "make test-all               quick and slow tests"
	@echo "make test-seeds             quick tests with other seeds each time"
	@echo "make test-versions          quick tests with the lowest, the tested and the newest versions of all packages"
	@echo "make test-newest            the demo and some of the tests with the newest versions, on Python 3.13"
	@echo "make test-processors        numerical tests as four other processors compute"
	@echo "make test-oldest-processor  the same as the oldest of them, which differs most"
	@echo "make check                  lint, format, types"
	@echo "make constraints            choose the newest versions to be the tested ones"
	@echo "make bench                  speed beside peers, and cost as curves: ten minutes on a quiet machine"
	@echo "make reproduce              all experiments: hours"
	@echo "make results                docs/results.md, pictures, and figures of README, from what was recorded; needs Chromium"
	@echo "make fuzz                   damaged inputs for every reader: 100,000, 9,500 of them states"
	@echo "make dist                   source distribution and wheel of what is committed, in dist/"
	@echo "make clean                  remove everything that make made, .venv too"

install: $(INSTALLED)

demo: $(INSTALLED)
	$(BIN)/rsmcm demo

docs: $(DOCS)
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going docs docs/_build/html

docs-links: $(DOCS)
	$(BIN)/sphinx-build --quiet --keep-going -b linkcheck docs docs/_build/links

test: $(TEST)
	$(BIN)/python -m pytest -n 2 -m "not slow"

test-slow: $(TEST)
	$(BIN)/python -m pytest -n 2 -m slow --maxfail 1 --hypothesis-profile long

test-all: $(TEST)
	$(BIN)/python -m pytest -n 2 --hypothesis-profile long

test-versions: $(DEV)
	$(NOX)

test-newest: $(DEV)
	$(NOX) --session newest_dependent

test-processors: $(DEV)
	$(NOX) --session processor

test-oldest-processor: $(DEV)
	$(NOX) --session "processor(nehalem)"

test-seeds: $(DEV)
	$(NOX) --session seeds

check: $(CHECK)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -p rsmcm

# OpenCV 5 has no Haar cascades, so faces would be tested with a model file only.
constraints: $(DEV)
	echo 'opencv-python-headless<5' | $(BIN)/uv pip compile --quiet --universal --upgrade --no-annotate \
		--custom-compile-command 'make constraints' --extra dev --constraint - \
		--output-file constraints.txt pyproject.toml

bench: $(TEST)
	$(BIN)/python -m rsmcm.apps.experiments.bench

reproduce: $(INSTALLED)
	for name in $$($(BIN)/python -c 'from rsmcm.apps.experiments import EXPERIMENTS; print(*EXPERIMENTS)'); \
		do $(BIN)/rsmcm reproduce $$name || exit 1; done

results: $(TEST)
	$(BIN)/python -m rsmcm.apps.experiments.results
	$(BIN)/python docs/pictures/figures.py
	$(BIN)/python docs/pictures/street.py
	$(BIN)/python docs/pictures/tutorial.py
	$(BIN)/python docs/pictures/pages.py

fuzz: $(TEST)
	$(BIN)/python -m tests.fuzz

dist: $(TEST)
	git diff --quiet HEAD || (echo "make dist: commit first: there are changes" >&2; exit 2)
	rm -rf dist
	mkdir -p dist/committed
	git archive HEAD | tar -x -C dist/committed
	$(BIN)/python -P -m build --no-isolation --outdir dist dist/committed
	rm -r dist/committed

clean:
	rm -rf .venv .nox build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis \
		docs/_build docs/generated
	find $(PACKAGES) tests -name __pycache__ -prune -exec rm -rf {} +

# The strict form of an editable install, of links to all modules, is one that type checkers can follow. It
# does not contain modules that were added later, so the list of modules is kept, and another list installs it again.
# What pip does not compile to bytecode, Python does when it is imported.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt \
	setuptools --config-settings editable_mode=strict --editable
ifneq ($(MODULES),$(shell cat $(INSTALLED) 2>/dev/null))
.PHONY: $(INSTALLED)
endif
$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python 3.11 or newer is needed; name it: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(INSTALL) .
	@echo $(MODULES) > $@

.venv/with-%: $(INSTALLED)
	$(INSTALL) '.[$*]'
	@touch $@
