# Two commands do everything on a fresh machine: `make demo` and `make test`.
# `make test-all` adds long statistics, the evaluation's own tests and long fuzzing.
# `make docs` builds the site, `make docs-check` runs every command of the documents,
# `make pictures` draws the documents' pictures again.
# `make smoke` installs the wheel for every other supported Python found here, and tunes with it.
# PYTHON is 3.11, 3.12 or 3.13.
# PIP_ARGS reaches pip, e.g. to take PyTorch's CPU build from its own index (see README).

BIN := .venv/bin
# that of .venv; else of the environment that is active; else 3.11, for which PyBullet has wheels
ACTIVE := $(firstword $(VIRTUAL_ENV) $(CONDA_PREFIX))
PYTHON ?= $(or $(wildcard $(BIN)/python),$(ACTIVE:%=%/bin/python),$(shell command -v python3.11 || command -v python3))
PIP_ARGS ?=
version = $(shell $(1) -c 'import platform; print("-".join((platform.python_implementation(), platform.python_version()[:4])))' 2>/dev/null)
# wheels alone, so that no compiler is needed; nflows (of sbi) has none, and is plain Python
INSTALL := PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet \
	--disable-pip-version-check --only-binary=:all: --no-binary=nflows $(PIP_ARGS)
# each core begins at another place, and takes half of what another has left when it is done
PYTEST := $(BIN)/pytest -n auto --dist worksteal
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# or every test worker and every command that a test starts would compile all again
unexport PYTHONDONTWRITEBYTECODE
SAMPLES := $(filter-out sample_logs/payload%,$(wildcard sample_logs/*.mcap))

.PHONY: demo test test-all smoke check style types suite docs docs-check pictures supported-python format \
	bench samples clean

demo: .venv/installed
	@mkdir -p demo
	$(BIN)/tunenet-record --simulate drop --restitution 0.72 --height 1.1 -o demo/drop.mcap --overwrite
	$(BIN)/tunenet-tune demo/drop.mcap $(SAMPLES) -o demo --overwrite
	$(BIN)/tunenet-tune sample_logs/payload.mcap --tare sample_logs/payload_empty.mcap -o demo --overwrite
	$(BIN)/tunenet-review sample_logs/campaign -o demo/campaign.rrd
	@echo "look at them: $(BIN)/rerun demo/filmed.rrd"

# types are checked beside the tests
test: .venv/developing
	@$(MAKE) --no-print-directory -j3 style types suite

suite: .venv/developing
	$(PYTEST) -m "not slow and not docs"

test-all: check
	$(PYTEST) -m "not docs" --hypothesis-profile=thorough

docs: .venv/developing
	$(BIN)/sphinx-build -q -W --keep-going -c docs -d build/doctrees . build/docs
	@echo "build/docs/index.html"

# in a clean copy, so that nothing is there which is not in the repository
docs-check: .venv/developing
	rm -rf build/clone
	git clone --quiet . build/clone
	cd build/clone && PYTHONPATH=$$PWD ../../$(PYTEST) tests/docs

pictures: .venv/developing
	$(BIN)/python docs/make_pictures.py

smoke: .venv/developing
	$(BIN)/python -m tests.smoke

check: style types

style: .venv/developing
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/developing
	$(BIN)/pyright

format: .venv/developing
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: .venv/developing
	$(BIN)/python -m tests.bench

samples: .venv/installed
	sh sample_logs/record.sh $(BIN)/tunenet-record
	sh sample_logs/campaign/record.sh $(BIN)/tunenet-record
	$(BIN)/python -m tunenet_logs.analysis.evaluation.worlds.machines

clean:
	rm -rf .venv demo build dist *.egg-info

supported-python:
	@case "$(call version,$(PYTHON))" in CPython-3.11|CPython-3.12|CPython-3.13) ;; \
	*) echo "PYTHON=$(PYTHON) is not CPython 3.11, 3.12 or 3.13; set PYTHON=/path/to/python3.12"; exit 1;; esac
	@test ! -e $(BIN)/python || test "$(call version,$(BIN)/python)" = "$(call version,$(PYTHON))" || \
		{ echo ".venv has $(call version,$(BIN)/python), PYTHON=$(PYTHON) another; run 'make clean' first, or leave PYTHON out"; exit 1; }

.venv/installed: pyproject.toml constraints.txt | supported-python
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(INSTALL) -e .
	@touch $@

.venv/developing: .venv/installed
	$(INSTALL) -e '.[cluster,dev,docs,eval,microphone,remote,ros2,tables,train]'
	$(BIN)/pyright --version
	@touch $@
