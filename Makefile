# Everything below needs only Python >= 3.11; the environment is made on first use.
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PYTHON ?= python3
DEMO_OUT ?= runs/demo

.PHONY: demo test test-all mutants check bench clean help

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

bench: $(READY)  ## measure error against run time of every registered component
	$(BIN)/olt bench all --out runs/bench

clean:  ## remove the environment and the runs
	rm -rf $(VENV) runs
