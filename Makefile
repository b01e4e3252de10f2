# Two commands on a fresh machine: `make demo` runs the main job, `make test` the tests. Each sets up .venv by itself.
PYTHON ?= python3
BIN := .venv/bin
# What is imported is compiled then: to compile all that is installed takes longer than the rest of it.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile

# Tests share out the cores: a process each and one more, for a test that waits leaves its core idle; one thread in each.
WORKERS := $(shell $(PYTHON) -c 'import os; print((os.cpu_count() or 1) + 1)')
PYTEST := $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal

.PHONY: install demo quick test check bench hil sensor clean

install: .venv/everything

# What the demo needs: the runtime and the simulated drive, no torch.
.venv/demo: pyproject.toml constraints.txt
	@echo "Installing what the demo needs into .venv: a few minutes, once."
	$(PYTHON) -m venv .venv
	$(PIP) --constraint constraints.txt --editable '.[workbench]'
	touch $@

.venv/everything: pyproject.toml constraints.txt
	@echo "Installing everything into .venv: many minutes, once."
	$(PYTHON) -m venv .venv
	$(PIP) --constraint constraints.txt --editable '.[all,dev]'
	touch $@

demo: .venv/demo
	$(BIN)/python examples/live_demo.py

# What to run on every change: a minute of what needs no simulation, fit or training.
quick: .venv/everything
	$(PYTEST) -m "not fit and not blind"

test: .venv/everything
	$(PYTEST) -m "not long"

check: .venv/everything
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(PYTEST)
	@echo "All good."

# The studies of benchmarks/measured.toml, written to docs/measured.md. `make bench BENCH=--quick`: those of minutes.
.venv/bench: .venv/everything
	$(PIP) --constraint constraints.txt --editable '.[all,dev,bench]'
	touch $@

bench: .venv/bench
	$(BIN)/python benchmarks/collect.py $(BENCH)

# Hardware in the loop: counts and bits are gates, latencies are reported beside the machine's load.
hil: .venv/everything
	$(BIN)/python benchmarks/hil.py $(BENCH)

# Rebuild the shipped sensors from their seed: a network on filters, for small microcontrollers, and a physics observer.
sensor: .venv/everything
	$(BIN)/motorlens train --motor models/motors/mellah2016.toml --seed 1 --hidden 12-8 \
		-o models/sensors/mellah2016.onnx
	$(BIN)/motorlens train --motor models/motors/mellah2016.toml --seed 1 --cycles 100 \
		-o models/sensors/mellah2016_observer.onnx

clean:
	rm -rf .venv out dist build
