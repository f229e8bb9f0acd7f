# make demo   set up a virtual environment and run the demonstration
# make test   the same, with the tools for testing, and run the tests that prove the product:
#             cores, wire, rig, bus, recorded runs, closed loops, live nodes
# make check  all other tests that CI runs; make long: those of many seconds; make devices: those
#             that need what not every machine has
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: dist sbom release publish docs-version dbc check long devices notebooks study swarm envelope dataset faults planted mutants firmware-mutants firmware-tools firmware-lint digests demo docs test installed pythons wheel acceptance kernels vcan vcan-stand silkit vcan-alone controllers test-containers lint types reference figures figures-all contracts shape locks stubs bench clean

# Images often forbid Python to keep what it has compiled; then each process compiles numpy and all
# else anew, for seconds.
unexport PYTHONDONTWRITEBYTECODE

# Packages by the digests of locks/ (tools/lock-packages), each of which is in one lock alone: two are
# installed at a time. --no-compile: of some 100 MB of Python a run
# imports a tenth, and compiles that as it does.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --no-deps
ITSELF := --no-build-isolation -e .

$(VENV)/run.stamp: pyproject.toml setup.py locks/build.txt locks/run.txt
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes -r locks/build.txt -r locks/run.txt
	$(INSTALL) $(ITSELF)
	touch $@

$(VENV)/test.stamp: pyproject.toml setup.py locks/build.txt locks/run.txt locks/test.txt
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes -r locks/test.txt & others=$$!; \
	    $(INSTALL) --require-hashes -r locks/build.txt -r locks/run.txt && wait $$others
	$(INSTALL) $(ITSELF)
	touch $@ $(VENV)/run.stamp

# A kernel to run notebooks in.
$(VENV)/notebook.stamp: $(VENV)/test.stamp locks/notebook.txt
	$(INSTALL) --require-hashes -r locks/notebook.txt
	touch $@

demo:
	@begun=$$(date +%s) && $(MAKE) --no-print-directory $(VENV)/run.stamp && \
	    MESHPOINT_SINCE=$$begun $(BIN)/meshpoint demo --out out/demo

SUITE := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder \
    --ignore=tests/acceptance --ignore=tests/vcan --ignore=tests/controllers_emulated

# The kernels first, or both workers compile the same ones at once.
test: kernels
	$(SUITE) -m "not long and not check and not device"

# Which these are: tests/conftest.py, and marks of single tests.
check: kernels $(VENV)/notebook.stamp
	$(SUITE) -m "check and not long and not device"

# What takes many seconds: whole documents held against runs, statistics over many shifts, crowds
# of live processes.
long: kernels
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "long and not device" $$(grep -rl --include='*.py' mark.long tests)

# What needs something that not every machine has: a CAN device, can-utils, multicast, a browser, root,
# captured edges (their folder: MESHPOINT_CAPTURES). What is not to be had here is skipped, and said.
devices: $(VENV)/test.stamp
	$(BIN)/python -m pytest -m device $$(grep -rl --include='*.py' mark.device tests)

# The notebooks of examples/ with what they show, after a change of them or of what a shift does.
notebooks: kernels $(VENV)/notebook.stamp
	$(BIN)/python tools/notebooks.py

# The wheel as a user installs it, and every command of README's table once.
installed: $(VENV)/test.stamp
	PYTHON=$(PYTHON) tools/test-installed

# The wheel in each Python that it is for, as far as this machine has them.
pythons: wheel
	PYTHON=$(PYTHON) tools/test-pythons dist/*.whl

# The wheel, with compiled kernels (docs/ci.md), in dist/.
wheel: $(VENV)/test.stamp
	rm -rf build/lib dist/*.whl
	$(BIN)/python -m build --no-isolation --wheel --outdir dist

# Source archive and wheel in dist/, looked at.
dist: $(VENV)/release.stamp
	rm -rf dist
	tools/build-dist dist
	$(BIN)/twine check --strict dist/*
	$(BIN)/python tools/release.py content dist

# What an installation consists of (CycloneDX), from what pip is to install for it.
sbom: $(VENV)/release.stamp
	mkdir -p build/sbom
	$(BIN)/cyclonedx-py requirements --pyproject pyproject.toml --mc-type library --output-reproducible \
	    --output-file build/sbom/meshpoint.cdx.json locks/run.txt

# All of a release but publishing it (docs/releasing.md): each of both installed in each Python that is
# here, every command of README once.
release: dist sbom
	for each in dist/*; do PYTHON=$(PYTHON) tools/test-pythons --whole $$each || exit 1; done
	PYTHON=$(PYTHON) tools/test-installed dist
	@$(BIN)/python tools/release.py lacks || echo "all of it works; before it is released, this has to be done"

# The one command that releases: tags this commit, and the tag's workflow publishes it.
publish: $(VENV)/release.stamp
	$(BIN)/python tools/release.py lacks
	$(MAKE) --no-print-directory release
	$(BIN)/python tools/release.py tag

# Real processes through the commands alone; some minutes.
acceptance: $(VENV)/test.stamp
	$(BIN)/python -m pytest tests/acceptance

kernels: $(VENV)/test.stamp
	$(BIN)/python -m meshpoint.bench.compiling

# The nodes on a real vcan0: of this machine, or of one that is emulated for the purpose. Its
# processor takes this machine's kernels; it would compile for an hour.
# Neither has it to compile what Python loads: the tests are collected here before.
# The limit is the last resort against a hang: what is waited for in there is bus time.
vcan: kernels
	{ tools/with-vcan --check && command -v candump; } || tools/with-vcan --install
	$(BIN)/python -m pytest tests/vcan/test_vcan.py --collect-only -q
	tools/with-vcan --timeout 3600 $(CURDIR)/$(BIN)/python -u -m pytest tests/vcan/test_vcan.py -v --durations=0

# A gearbox that stands, behind the board's firmware, on vcan0: ready, and each output right.
vcan-stand: kernels
	tools/with-vcan --timeout 3600 \
	    $(CURDIR)/$(BIN)/python -u -m pytest tests/vcan/test_stand.py -v --durations=0

# Controller and rig as participants of SIL Kit, in a Python that silkit-py has a wheel for: an
# environment of its own, with the wheel of meshpoint, whose kernels need not be compiled there. Run in
# tests/, where Python does not find the sources before it.
SILKIT := $(VENV)-silkit
silkit: wheel
	python=$$(PYTHON=$(PYTHON) tools/silkit-python) && \
	    $(MAKE) --no-print-directory VENV=$(SILKIT) PYTHON=$$python $(SILKIT)/test.stamp
	$(SILKIT)/bin/python -m pip install --quiet --no-compile --no-deps --force-reinstall dist/*.whl
	cd tests && $(CURDIR)/$(SILKIT)/bin/pytest -o pythonpath= -m "device and not long" silkit

# The nodes on emulated CAN controllers with their real drivers: a Kvaser PCI card and a CTU CAN FD card.
controllers: kernels
	{ tools/with-vcan --controllers --check && command -v candump; } || \
	    tools/with-vcan --controllers --install
	tools/with-vcan --controllers --timeout 5400 \
	    $(CURDIR)/$(BIN)/python -u -m pytest tests/controllers_emulated -v --durations=0

# with-vcan as other projects have it, as a command and as an action, and python-can's own SocketCAN tests
# in it.
vcan-alone: $(VENV)/test.stamp
	tools/vcan/test-with-vcan
	actions/with-vcan/test
	tools/vcan/test-python-can $(CURDIR)/$(BIN)/python

# Every figure and table of the thesis, ours beside it, on one page: out/study/studies.html
study: $(VENV)/test.stamp
	$(BIN)/python -m benchmarks.studies all

# Every kind of shift, sheet and sensor in one table, docs/envelope.md: an hour on two quiet processors.
# ARGS: see python -m benchmarks.envelope -h
envelope: kernels
	$(BIN)/python -m benchmarks.envelope --resume --markdown docs/envelope.md $(ARGS)

# A small open data set of simulated shifts with a task on it (docs/dataset.md), made anew in
# out/dataset. ARGS: see python -m benchmarks.dataset -h
dataset: kernels
	rm -rf out/dataset
	$(BIN)/python -m benchmarks.dataset --out out/dataset $(ARGS)

# Worlds in which anything may fail, for so many seconds; says how many hours were simulated.
SWARM_WALL_S ?= 60
SWARM_SEED ?= 1
swarm: $(VENV)/test.stamp
	$(BIN)/python -m benchmarks.swarm --hours 100 --wall $(SWARM_WALL_S) --seed $(SWARM_SEED)

# A hundred hours of them, in parts: interrupted, it goes on where it was.
swarm-nightly: $(VENV)/test.stamp
	mkdir -p out
	$(BIN)/python -m benchmarks.swarm --hours 100 --seed $(SWARM_SEED) --out out/swarm --resume \
	    --json out/swarm.json

# The table of docs/reference/faults.md, from scenarios that are run for it.
faults: $(VENV)/test.stamp
	$(BIN)/python -m benchmarks.swarm.named docs/reference/faults.md

# Each bug of tests/planted in a copy of the product: is it caught?
planted: $(VENV)/test.stamp
	$(BIN)/python tests/planted/run_planted.py

# The records that tests/closed_loop/test_recorded_runs.py holds each run against: made anew after a
# change that is meant to change what a shift does.
digests: $(VENV)/test.stamp
	$(BIN)/python tests/closed_loop/recorded_runs.py

# Small mistakes in what must not fail, one at a time: does a test catch each? CHANGED=1: only lines
# that differ from where this branch left origin/main, and no more than can be run in a minute; ARGS:
# see tools/mutation/run_mutants.py.
mutants: $(VENV)/test.stamp
	$(BIN)/python tools/mutation/run_mutants.py $(if $(CHANGED),--changed --wall 60) $(ARGS)

# The same for the firmware's slots, expiry and output stage, compiled anew each time.
firmware-mutants: $(VENV)/test.stamp
	$(BIN)/python tests/firmware/run_mutants.py $(ARGS)

# What `pip install meshpoint[firmware]` brings, and Debian's packages for the board's processor.
firmware-tools: $(VENV)/test.stamp locks/firmware.txt
	tools/firmware-tools --install
	$(INSTALL) --require-hashes -r locks/firmware.txt

# cppcheck with its rules of MISRA C:2012, but for those of the list.
firmware-lint:
	cppcheck --quiet --std=c11 --platform=unix32 --enable=style,unusedFunction --addon=misra \
	    -DIMAGE_SENSOR=1 -DIMAGE_VALVE=1 -DIMAGE_TEETH=0 --suppressions-list=tools/firmware-rules.txt \
	    --error-exitcode=1 $$(find firmware -name '*.c' -not -path '*/native/*')

test-containers:
	tools/test-containers

# Style, and the rules of tools/rules: words, names and links of documents; what sources may not do.
lint: $(VENV)/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tools/lint.py

types: $(VENV)/test.stamp
	tools/linked-tree
	$(BIN)/mypy
	$(BIN)/python -m meshpoint.dbc.stubs --check
	$(BIN)/python -m meshpoint.dbc.schema --check

# docs/reference/, from the code
reference: $(VENV)/test.stamp
	$(BIN)/python -m meshpoint.cli.reference docs/reference
	$(BIN)/python -m meshpoint.api.reference docs/reference/api.md

# What is made from dbc/meshpoint.dbc and dbc/truck.dbc, after a change of them.
dbc: $(VENV)/test.stamp
	$(BIN)/python -m meshpoint.dbc.schema
	$(BIN)/python -m meshpoint.dbc.stubs
	$(BIN)/python -m meshpoint.dbc.classic.make
	$(BIN)/python -m meshpoint.dbc.j1939_view
	$(BIN)/python tests/dbc/test_frozen_contract.py
	$(MAKE) reference

# docs/figures.toml into the documents that show its figures, and of what code they are: to be run after
# each change of that code, too; NAME=typical: measures that one again first.
figures: $(VENV)/test.stamp
	$(BIN)/python tools/figures.py $(NAME)

# Measures all again whose code has changed since, one after the other, and names those that are entered by
# hand. Two to three hours on two processors, most of it swarm_longest on one; interrupted, it goes on.
figures-all: kernels
	$(BIN)/python tools/figures.py --all

# locks/, after a change to constraints.txt or to the dependencies
locks:
	tools/lock-packages

$(VENV)/docs.stamp: $(VENV)/test.stamp locks/docs.txt
	$(INSTALL) --require-hashes -r locks/docs.txt
	touch $@

$(VENV)/release.stamp: $(VENV)/docs.stamp locks/release.txt
	$(INSTALL) --require-hashes -r locks/release.txt
	touch $@

# The documentation as a site in build/site. A link that leads nowhere is an error.
docs: $(VENV)/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

# The same under a version, beside the others, on the branch gh-pages of this clone.
docs-version: $(VENV)/release.stamp
	PATH="$(CURDIR)/$(BIN):$$PATH" NO_MKDOCS_2_WARNING=1 $(BIN)/mike deploy --update-aliases --alias-type copy "$(VERSION)" latest
	$(BIN)/mike set-default latest

contracts: $(VENV)/test.stamp
	tools/linked-tree
	cd build/tree && $(CURDIR)/$(BIN)/lint-imports --config $(CURDIR)/pyproject.toml --cache-dir ../import_linter

# Files, lines, rooms, floors and arrows, counted.
shape: $(VENV)/test.stamp
	tools/linked-tree
	$(BIN)/python tools/shape.py

bench: $(VENV)/test.stamp
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) $(SILKIT) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
