# make demo   set up a virtual environment and run the demonstration
# make test   the same, with the tools for testing, and run all tests
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test installed acceptance vcan test-containers lint types contracts stubs bench clean

$(VENV)/run.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e .
	touch $@

$(VENV)/test.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[test]"
	touch $@ $(VENV)/run.stamp

demo:
	@begun=$$(date +%s) && $(MAKE) --no-print-directory $(VENV)/run.stamp && \
	    MESHPOINT_SINCE=$$begun $(BIN)/meshpoint demo --out out/demo

test: $(VENV)/test.stamp
	$(BIN)/python -m pytest -n 2 --dist loadfile --ignore=tests/acceptance

# The wheel as a user installs it, and every command of README's table once.
installed:
	PYTHON=$(PYTHON) tools/test-installed

# Real processes through the commands alone; some minutes.
acceptance: $(VENV)/test.stamp
	$(BIN)/python -m pytest tests/acceptance

# The nodes on a real vcan0: of this machine, or of one that is emulated for the purpose.
vcan: $(VENV)/test.stamp
	NUMBA_DISABLE_JIT=1 tools/with-vcan --install --timeout 900 $(CURDIR)/$(BIN)/python -u -m pytest tests/vcan \
	    -v -p no:cacheprovider --timeout 900

test-containers:
	tools/test-containers

lint: $(VENV)/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/test.stamp
	$(BIN)/mypy
	$(BIN)/python -m meshpoint.dbc.stubs --check

contracts: $(VENV)/test.stamp
	$(BIN)/lint-imports

bench: $(VENV)/test.stamp
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
