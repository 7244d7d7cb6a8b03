# make setup   the environment .venv, with polhode in it
# make demo    the shipped sample, end to end; the last line names the report
# make test    the tests            make check   style, types, import rules
# make bench   the thesis's session: simulate, run, evaluate, with the seconds of each stage

PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
DEMO_RUN := runs/demo
BENCH_DATA := data/ts38
BENCH_RUN := runs/ts38

.PHONY: setup demo test check bench
.DEFAULT_GOAL := setup

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "polhode: error: $(PYTHON) is older than 3.11; give a newer one: make setup PYTHON=python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	    { echo "polhode: error: $(PYTHON) cannot make environments; on Debian: apt-get install python3-venv" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: setup
	$(BIN)/polhode run configs/default.yaml --data sample -o $(DEMO_RUN) --overwrite
	$(BIN)/polhode evaluate $(DEMO_RUN) sample
	@echo "Demo done. Open $(DEMO_RUN)/report.html"

test: setup
	$(BIN)/python -m pytest

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

$(BENCH_DATA): configs/ts38.yaml
	$(BIN)/polhode simulate $< -o $@ --overwrite

bench: setup $(BENCH_DATA)
	$(BIN)/polhode run configs/default.yaml --data $(BENCH_DATA) -o $(BENCH_RUN) --overwrite
	$(BIN)/polhode evaluate $(BENCH_RUN) $(BENCH_DATA)
	$(BIN)/python -c 'import json; print(json.load(open("$(BENCH_RUN)/summary.json"))["timing_s"])'
