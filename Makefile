# What a newcomer needs: `make demo` and `make test`. CI calls the same targets.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3 /usr/bin/python3; do \
    command -v $$p >/dev/null 2>&1 && $$p -c 'import sys, tkinter; sys.exit(sys.version_info < (3, 11))' \
    >/dev/null 2>&1 && command -v $$p && break; done)
BIN := .venv/bin

.PHONY: demo test lint types contracts bench figures lock install clean

demo: install  ## the main job on the simulated rig
	@$(BIN)/labrig demo

test: install  ## everything that is right or wrong
	@$(BIN)/python -m pytest -n auto --dist worksteal

lint: install
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .

types: install
	@$(BIN)/mypy

contracts: install
	@$(BIN)/lint-imports

bench: install  ## everything that is fast or slow
	@$(BIN)/python -m pytest tests/benchmarks --benchmark-enable -q -s

figures: install  ## the pictures of the README, from a run of the demo and of labrig accuracy
	@rm -rf build/figures && $(BIN)/labrig demo --out build/figures >/dev/null
	@mkdir -p docs/images && cp build/figures/*/*/results/*/figures/attenuation.png \
	    build/figures/*/*/results/*/figures/light-field.png docs/images/
	@$(BIN)/labrig accuracy solver configs/scenes/dilute-milk.yaml --out build/figures/accuracy
	@cp build/figures/accuracy/solver.png docs/images/accuracy-cost.png

install: .venv/installed

.venv/installed: requirements.lock pyproject.toml
	@if [ -z "$(PYTHON)" ]; then \
	    echo "labrig needs Python 3.11 or newer with tkinter, venv and pip; none was found."; \
	    echo "On Debian: sudo apt-get install python3 python3-tk python3-venv"; exit 1; fi
	@if [ ! -x $(BIN)/python ]; then echo "labrig: making .venv with $(PYTHON)"; \
	    $(PYTHON) -m venv .venv || { rm -rf .venv; echo "labrig: no virtual environment could be made; on Debian: sudo apt-get install python3-venv"; exit 1; }; fi
	@echo "labrig: installing from requirements.lock (a minute or two, once)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

lock:  ## pin the newest versions that pyproject.toml allows (needs uv)
	uv pip compile --universal --python-version 3.11 --extra dev --generate-hashes \
	    --no-emit-index-url --no-annotate --custom-compile-command "make lock" \
	    --upgrade pyproject.toml -o requirements.lock

clean:  ## what was made here, except sessions
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache *.egg-info .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
