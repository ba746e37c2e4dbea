# Everything below needs only Python >= 3.11; the environment is made on first use.
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PYTHON ?= python3
DEMO_OUT ?= runs/demo

.PHONY: demo test test-all check docs wheels floors mutants sizes bench requirements clean help

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/:/' | column -t -s:

$(READY): requirements.txt pyproject.toml
	PYTHON=$(PYTHON) sh tools/make_environment.sh $(VENV)
	touch $(READY)

demo: $(READY)  ## run the main job: one front video to a closed-loop score
	$(BIN)/olt demo --out $(DEMO_OUT)

test: $(READY)  ## run the fast tests
	$(BIN)/python -m pytest -n auto -m "not slow"

test-all: $(READY)  ## run every test
	$(BIN)/python -m pytest -n auto

mutants: $(READY)  ## put small faults into numerical modules; tests must notice them (half an hour)
	$(BIN)/python tools/mutants.py

check: $(READY)  ## lint, types, layering
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

docs: $(READY)  ## build the documentation site into build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

wheels: $(READY)  ## build what is shipped, install it outside the checkout and run it there
	sh tools/check_wheels.sh $(VENV)

floors: $(READY)  ## run the fast tests on the lowest versions that the dependencies allow
	$(BIN)/uv venv --quiet --clear --python $(PYTHON) .venv/floors
	VIRTUAL_ENV=.venv/floors $(BIN)/uv pip install --quiet --resolution lowest-direct --editable toolkit/generator --editable '.[dev]'
	.venv/floors/bin/python -m pytest -n auto -m "not slow" -p no:cacheprovider

sizes: $(READY)  ## measure the source: lines, functions, helpers called once, cycles
	$(BIN)/python tools/measure_code.py

requirements: $(READY)  ## pin the environment again; what is pinned stays where it can
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --extra dev --no-annotate --custom-compile-command 'make requirements' \
		--no-emit-package openlongtail --no-emit-package olt-generator \
		pyproject.toml toolkit/generator/pyproject.toml --output-file requirements.txt

bench: $(READY)  ## measure error against run time of every registered component
	$(BIN)/olt bench all --out runs/bench

clean:  ## remove the environment and the runs
	rm -rf $(VENV) runs
