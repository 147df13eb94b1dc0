# Each target makes its own virtual environment in .venv; nothing but Python, make and a network is needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check

.PHONY: help demo test unit torture lint format bench clean

help:  ## say what there is
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

$(VENV)/demo: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP) install -e '.[demo]'
	@touch $@

$(VENV)/dev: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP) install -e '.[demo,dev]'
	@touch $@

demo: $(VENV)/demo  ## record a Franka arm at 1 kHz, read it back, plot it
	$(BIN)/python examples/franka_control.py --root .dash

test: lint unit  ## everything that CI checks

lint: $(VENV)/dev  ## style, format, types, import directions, sizes and names
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python tools/check_imports.py
	$(BIN)/python tools/check_house.py
	$(BIN)/python tools/list_rooms.py --check

unit: $(VENV)/dev  ## the tests, side by side on all cores
	$(BIN)/python -m pytest -n auto --dist worksteal

torture: $(VENV)/dev  ## the laws on eighty times as many examples (some hours)
	HYPOTHESIS_PROFILE=thorough $(BIN)/python -m pytest -n auto --dist worksteal --timeout 3600

format: $(VENV)/dev  ## put the code into its format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/dev  ## measure beside the peers and write docs/benchmarks.md (about an hour)
	$(PIP) install -e '.[bench]'
	$(BIN)/python tools/bench_append.py --out docs/benchmarks.md
	$(BIN)/python tools/bench_read.py --out docs/benchmarks.md
	$(BIN)/python tools/bench_ros.py --out docs/benchmarks.md
	$(BIN)/python tools/bench_bags.py --out docs/benchmarks.md
	$(BIN)/python tools/bench_mocap.py --out docs/benchmarks.md

clean:  ## remove what the targets made
	rm -rf $(VENV) .dash .dreamlake .pytest_cache .mypy_cache .ruff_cache
