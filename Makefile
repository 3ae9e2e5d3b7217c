# Every target sets up .venv by itself from requirements.lock, and again only when that or pyproject.toml changes.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help install warm demo test bounds check format bench lock clean

PYTHON ?= $(shell for p in python3.11 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
STAMP := .venv/installed
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input
CODE := core protocol services tests

help:  ## what can be made
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /make \1\t/' | expand -t 16

install: $(STAMP)  ## set up .venv (the others do this by themselves)

$(STAMP): requirements.lock pyproject.toml
	@[ -n "$(PYTHON)" ] || { echo "zsight needs Python 3.11 or newer: name one with make PYTHON=..." >&2; exit 2; }
	@echo "setting up .venv with $$($(PYTHON) --version): $$(grep -c '==' requirements.lock) packages, some minutes the first time"
	@$(PYTHON) -m venv .venv
	@$(PIP) install -r requirements.lock | { grep --line-buffered -oE '^Collecting [^ ]+|^Installing' || true; }
	@$(PIP) install --quiet --no-deps --no-build-isolation -e .
	@touch $@
	@echo ".venv is ready"

warm: $(STAMP)  ## compile the kernels, once a machine
	@$(BIN)/zsight warm

demo: warm  ## find the toy block in a simulated scene, with every process of its own
	@$(BIN)/zsight demo

test: warm  ## run all tests
	$(BIN)/python -m pytest

bounds: $(STAMP)  ## run the laws of the kernels once with every index checked, in a cache of its own
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/.cache/bounds $(BIN)/python -m pytest -q --timeout 600 \
		tests/core/test_kernel_laws.py tests/core/test_image_normals.py tests/core/test_multi_plane.py

check: $(STAMP)  ## format, lint, types, imports
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy $(CODE)
	$(BIN)/lint-imports

format: $(STAMP)  ## put the code into its form
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

bench: warm  ## measure something beside its peers with NAME=; without, say what there is
	@$(BIN)/zsight bench $(NAME)

lock: $(STAMP)  ## pin the newest versions that pyproject.toml allows
	@$(BIN)/python .ci/write_lock.py

clean:  ## remove .venv and all caches
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +
