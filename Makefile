# Two commands do all the set-up: `make paper` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN := runs/paper
# Python compiles a module when it is first imported. To compile all of them here would take half of the installation.
PIP = $(BIN)/python -m pip install --no-compile --disable-pip-version-check --constraint constraints.txt

.PHONY: paper test test-tools test-slow test-faults test-all check doctor before-tests faults docs reproduction benchmark clean help

help:
	@echo "make paper        install, run the paper's campaign, compare it with static sampling"
	@echo "make test         install, run the checks: lint, types, imports and tests"
	@echo "make test-tools   those of the tests that need what make does not install: a browser, OpenSees, records"
	@echo "make test-slow    those of the tests that take long"
	@echo "make test-faults  install, try a few states of each fault of the fault suite (docs/reliability.md)"
	@echo "make test-all     all of them with the exhaustive tests: more cases, and claims that take very long to test"
	@echo "make faults       install, try every state of the fault suite"
	@echo "make docs         install, build the site of the documentation in build/docs"
	@echo "make reproduction install, write docs/reproduction.md and its figures anew"
	@echo "make benchmark    install, measure the simulator against SciPy's solvers"
	@echo "make clean        remove the virtual environment (run folders stay)"

# Tests need the extra `dev`, the paper's campaign the package alone. The stamp is newer than what it was installed from; a
# change of either installs again.
$(VENV)/.installed: WHAT = .[dev]
$(VENV)/.package: WHAT = .
$(VENV)/.installed $(VENV)/.package: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "activefail needs Python 3.11 or newer; name one with make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	@if [ "$$(uname)" = Linux ] && $(PIP) --dry-run --no-deps torch 2>/dev/null | grep -q 'torch-[0-9.]*$$'; then echo "pip found no CPU build of torch: the default build is coming, several GB with CUDA. To avoid it, press Ctrl-C and see README.md, Installation."; fi
	@echo "Installing into $(VENV): some minutes the first time, and up to 3 GB of disk."
	$(PIP) --quiet --editable '$(WHAT)' || { echo "Installing failed; see README.md, Installation."; exit 1; }
	@touch $@

# An interrupted campaign goes on where it stopped.
paper: $(or $(wildcard $(VENV)/.installed),$(VENV)/.package)
	@if [ -f $(RUN)/campaign.toml ]; then $(BIN)/activefail resume $(RUN); \
	else $(BIN)/activefail run campaigns/paper.toml --out $(RUN); fi
	@$(BIN)/activefail status $(RUN)
	@echo "run folder $(CURDIR)/$(RUN)"
	@$(BIN)/activefail compare $(RUN) --static 500,1000,2000,4000 --seeds 3 --test 20000

check: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Compiles the simulator on one core. Otherwise the tests would wait for it.
doctor: $(VENV)/.installed
	$(BIN)/activefail doctor

before-tests: $(VENV)/.installed
	@$(MAKE) --no-print-directory --jobs 2 check doctor

# Two runs: the core's tests on a copy without the plug-in, and the plug-in's (tests/wings.py). A process for each core, at
# most four. Files come in the order of their names: if those with most tests came first, the slow files, which have few,
# would come last.
PYTEST = $(BIN)/python tests/wings.py -n logical --maxprocesses 4 --dist loadfile --no-loadscope-reorder

test: before-tests
	$(PYTEST) -m "not faults and not slow"

# Without what they need they are skipped (tests/tools.py).
test-tools: $(VENV)/.installed
	$(PYTEST) -m "needs and not slow"

test-slow: $(VENV)/.installed
	$(PYTEST) -m "slow and not faults"

# With strace (Debian: apt install strace) the fault suite also kills programs at their system calls.
test-faults: $(VENV)/.installed
	$(PYTEST) -m faults

test-all: before-tests
	$(PYTEST) --exhaustive

faults: $(VENV)/.installed
	$(PYTEST) -m faults --every-fault

# A warning is an error. Every page is read again: the reference comes from the code.
docs: $(VENV)/.installed
	$(BIN)/python -m sphinx -b html -d build/doctrees -E -W --keep-going -q docs build/docs
	@echo "the site: build/docs/index.html"

reproduction: $(VENV)/.installed
	$(BIN)/activefail paper --out docs

benchmark: $(VENV)/.installed
	$(BIN)/python studies/simulator.py

clean:
	rm -rf $(VENV)
