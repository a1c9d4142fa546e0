# Needs only Python 3.11 or newer with pip; everything else goes into .venv.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed
PACKAGES := rsmcm.models rsmcm.inference rsmcm.chains rsmcm.apps

.PHONY: help demo test test-all check bench fuzz clean
.DELETE_ON_ERROR:

help:
	@echo "make demo      track the people in a built-in scene"
	@echo "make test      quick tests"
	@echo "make test-all  quick tests and long experiments"
	@echo "make check     lint, format, types of the installed package"
	@echo "make bench     speed and accuracy beside peers"
	@echo "make fuzz      damaged inputs for every reader: 100,000 in about ten minutes"
	@echo "make clean     remove everything that make made, .venv too"

demo: $(INSTALLED)
	$(BIN)/rsmcm demo

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 -m "not slow"

test-all: $(INSTALLED)
	$(BIN)/python -m pytest -n 2

# Checkers do not follow an editable install, so the types are checked in a regular one beside it.
check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	rm -rf build
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --target build/checked .
	cd build/checked && ../../$(BIN)/mypy --strict --config-file ../../pyproject.toml \
		--cache-dir ../../.mypy_cache $(addprefix -p ,$(PACKAGES))

bench: $(INSTALLED)
	$(BIN)/python -m rsmcm.apps.bench

fuzz: $(INSTALLED)
	$(BIN)/python -m tests.fuzz

clean:
	rm -rf .venv build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find apps chains inference models tests -name __pycache__ -prune -exec rm -rf {} +

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python 3.11 or newer is needed; name it: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt setuptools --editable '.[dev]'
	touch $@
