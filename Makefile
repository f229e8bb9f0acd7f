# make demo   set up a virtual environment and run the demonstration
# make test   the same, with the tools for testing, and run all tests
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test acceptance lint types contracts stubs bench clean

$(VENV)/run.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[all]"
	touch $@

$(VENV)/test.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[all,test]"
	touch $@ $(VENV)/run.stamp

demo: $(VENV)/run.stamp
	$(BIN)/meshpoint demo --out out/demo

test: $(VENV)/test.stamp
	$(BIN)/python -m pytest -n 2 --dist loadfile --ignore=tests/acceptance

# Real processes through the commands alone; wants a machine that keeps time.
acceptance: $(VENV)/test.stamp
	$(BIN)/python -m pytest tests/acceptance

lint: $(VENV)/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/test.stamp
	$(BIN)/mypy
	$(BIN)/python -m dbc.stubs --check

contracts: $(VENV)/test.stamp
	$(BIN)/lint-imports

bench: $(VENV)/test.stamp
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
