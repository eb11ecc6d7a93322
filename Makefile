# Everything a developer or CI runs.  Needs git, make and Python 3.11, 3.12 or 3.13; the rest goes into .venv.

PYTHON ?= python3
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input -q
PINNED := --upgrade --universal --python-version 3.11 --generate-hashes --no-annotate --no-emit-index-url --no-header --quiet
SOURCES := src tests benchmarks examples
WEB := src/covey/playground/web

.DEFAULT_GOAL := help
.PHONY: help setup demo test soak check format bench images web lock clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(VENV)/.installed  ## make the virtual environment with the pinned requirements

demo: setup  ## fly the thesis's mission in MuJoCo; show the deployment, draw and film the flight
	@rm -rf build/demo
	$(BIN)/covey fly examples/thesis-5.1.yaml --out build/demo --film
	@echo "Look at build/demo: flight.png, deployment.png and the film flight.mp4 (flight.gif without ffmpeg)."

test: setup  ## run all tests
	$(BIN)/python -m pytest -n $(JOBS)

soak: setup  ## run all tests with long seed sweeps and long fuzzing
	$(BIN)/python -m pytest -n $(JOBS) --soak

check: setup  ## format, lint, types, layers
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/lint-imports

format: setup  ## format the sources and mend what the linter can
	$(BIN)/ruff check --fix $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

bench: $(VENV)/.bench  ## print the benchmarks as JSON
	@$(BIN)/python benchmarks/run.py

images: setup  ## draw the pictures of the documentation anew; needs Chromium
	$(BIN)/covey plan examples/thesis-5.1.yaml --out build/images --bound --baseline --quiet --force
	cp build/images/deployment.png docs/images/deployment.png
	$(BIN)/covey fly examples/thesis-5.1.yaml --out build/images-flight --quiet --force
	cp build/images-flight/flight.png docs/images/flight.png
	$(BIN)/covey heatmap --out docs/images/visibility.png --force
	$(BIN)/python -m tests.browser.pictures

web: setup  ## build the Playground's page from its sources; needs Node.js and npm
	$(BIN)/python -m covey.playground.typescript > $(WEB)/src/messages.ts
	cd $(WEB) && npm install --no-package-lock --no-fund --no-audit --loglevel=error && npm run --silent check && npm run --silent build

lock: setup  ## pin the requirements anew
	$(BIN)/uv pip compile pyproject.toml requirements/dev.in --output-file requirements/dev.txt $(PINNED)
	$(BIN)/uv pip compile requirements/bench.in --constraint requirements/dev.txt --output-file requirements/bench.txt \
	    $(PINNED)

clean:  ## remove the virtual environment and everything built
	rm -rf $(VENV) build dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	rm -rf $(WEB)/node_modules
	find src tests benchmarks examples -name __pycache__ -type d -prune -exec rm -rf {} +

# Made anew whenever the pins change, so that it holds exactly what they name.
$(VENV)/.requirements: requirements/dev.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' || \
	    { echo "covey needs Python 3.11, 3.12 or 3.13; choose one with: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' || \
	    { echo "this Python cannot make virtual environments; on Debian: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP) install --require-hashes -r requirements/dev.txt
	@touch $@

$(VENV)/.installed: $(VENV)/.requirements pyproject.toml
	$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.bench: $(VENV)/.installed requirements/bench.txt
	$(PIP) install --require-hashes -r requirements/bench.txt
	@touch $@
