# Two commands do everything on a fresh machine: `make demo` and `make test`.
# `make test-all` adds long statistics, the evaluation's own tests and long fuzzing.
# PIP_ARGS reaches pip, e.g. to take PyTorch's CPU build from its own index (see README).

PYTHON ?= $(shell command -v python3.11 || command -v python3)
PIP_ARGS ?=
BIN := .venv/bin
PYTEST := $(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# or every test worker and every command that a test starts would compile all again
unexport PYTHONDONTWRITEBYTECODE
SAMPLES := $(filter-out sample_logs/payload%,$(wildcard sample_logs/*.mcap))

.PHONY: demo test test-all check format bench samples clean

demo: .venv/installed
	@mkdir -p demo
	$(BIN)/tunenet-record --simulate drop --restitution 0.72 --height 1.1 -o demo/drop.mcap --overwrite
	$(BIN)/tunenet-tune demo/drop.mcap $(SAMPLES) -o demo --overwrite
	$(BIN)/tunenet-tune sample_logs/payload.mcap --tare sample_logs/payload_empty.mcap -o demo --overwrite
	$(BIN)/tunenet-review sample_logs/campaign -o demo/campaign.rrd
	@echo "look at them: $(BIN)/rerun demo/drop.rrd"

test: check
	$(PYTEST) -m "not slow"

test-all: check
	$(PYTEST) --hypothesis-profile=thorough

check: .venv/developing
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: .venv/developing
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: .venv/developing
	$(BIN)/python -m benchmarks

samples: .venv/installed
	sh sample_logs/record.sh $(BIN)/tunenet-record
	sh sample_logs/campaign/record.sh $(BIN)/tunenet-record

clean:
	rm -rf .venv demo build dist *.egg-info

.venv/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
		{ echo "CPython 3.11 is needed (PyBullet has no wheels for others); set PYTHON=/path/to/python3.11"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) -e .
	@touch $@

.venv/developing: .venv/installed
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) -e '.[dev,eval,ros2,tables]'
	$(BIN)/pyright --version
	@touch $@
