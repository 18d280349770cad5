# make help lists the targets. Everything runs in .venv; nothing outside this folder is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DATA ?= ../shared/data
JOBS ?= 2

.DEFAULT_GOAL := help
.PHONY: help install demo serve test check format bench evaluate lock clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

install: $(STAMP)  ## create .venv and install what requirements.lock pins (uv if present, else pip)

$(STAMP): requirements.lock pyproject.toml clients/python/pyproject.toml
	@if command -v uv >/dev/null 2>&1; then \
	  test -x $(BIN)/python || uv venv --quiet --python $(PYTHON) $(VENV); \
	  uv pip install --quiet --python $(BIN)/python --require-hashes -r requirements.lock && \
	  uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation -e . -e clients/python; \
	else \
	  test -x $(BIN)/python || $(PYTHON) -m venv $(VENV); \
	  $(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip >/dev/null; \
	  $(BIN)/python -m pip install --quiet --require-hashes -r requirements.lock && \
	  $(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e . -e clients/python; \
	fi
	@touch $(STAMP)

demo: install  ## a real building: survey, map, unseen walks, table and plots (KEEP=1 leaves the service running)
	$(BIN)/isodyn demo $(if $(KEEP),--keep)

serve: install  ## start the service on 127.0.0.1:8080 with ./data as its data folder
	$(BIN)/isodyn serve

test: install  ## all tests on JOBS=2 cores, those that measure time alone, the kernels' once more without compilation
	$(BIN)/python -m pytest -m "not timing" -n $(JOBS) --dist loadfile --no-loadscope-reorder
	$(BIN)/python -m pytest -m timing
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest tests/reference

check: install  ## formatting, lint, types, import contracts
	$(BIN)/ruff format --check app tests clients maps
	$(BIN)/ruff check app tests clients maps
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install  ## format and mend what can be mended
	$(BIN)/ruff format app tests clients maps
	$(BIN)/ruff check --fix app tests clients maps

bench: install  ## kernels and map building against their goals and their peers (writes bench-out/)
	$(BIN)/python -m tests.benchmarks --out bench-out
	$(BIN)/isodyn bench kernels --json bench-out/kernels.json

evaluate: install  ## the shared floors with DATA=<folder of data sets>
	$(BIN)/isodyn evaluate ilc20 --data $(DATA) --jobs 2 --json bench-out/ilc20.json

lock:  ## write requirements.lock anew from pyproject.toml (needs uv)
	uv lock --quiet --upgrade
	uv export --quiet --format requirements-txt --no-emit-project --no-header > requirements.lock

clean:  ## remove what the targets made
	rm -rf $(VENV) demo-out bench-out .mypy_cache .ruff_cache .pytest_cache .hypothesis
