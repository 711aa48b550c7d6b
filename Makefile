# Thin names over the real commands; everything here works by hand, too (see README.md).
PYTHON ?= python3.11
ifeq (,$(shell command -v $(PYTHON)))
PYTHON := python3
endif
BIN := .venv/bin
READY := .venv/ready

.PHONY: run test test-all check fmus tables bench clean

run: $(READY)  ## the main job: build the FMUs, close the loop for 20 s, write the report
	$(BIN)/steadytip run closed_loop

test: $(READY)  ## quick tests
	$(BIN)/python -m pytest -n auto --dist loadgroup

test-all: $(READY)  ## quick and slow tests
	$(BIN)/python -m pytest -n auto --dist loadgroup -m ""

check: $(READY)  ## format, lint, types, import directions, generated tables, tests
	@$(BIN)/python tests/check.py

fmus: $(READY)  ## every model as a native and as a Python FMU
	$(BIN)/steadytip build --flavour native
	$(BIN)/steadytip build --flavour python

tables: $(READY)  ## the pages generated from the models
	$(BIN)/python -m fmu_src.pack.models_page

bench: $(READY)  ## figures of speed; minutes, see `steadytip bench --help`
	$(BIN)/steadytip bench

clean:  ## everything built; the environment stays
	find build -mindepth 1 -not -name README.md -delete

$(READY): pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $(READY)
