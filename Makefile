# make help    this list
# make setup   the environment .venv, with polhode in it and the tools of its developers (make setup EXTRAS=: without)
# make demo    the shipped sample, end to end; the last line names the report
# make example    flies around the target of the demo in MuJoCo, with a video (docs/planning.md)
# make test    the tests, in two processes (make test JOBS=4: in four)
# make check   style, types, import rules
# make setup-tests    the environment with what tests and site need besides, in one installation
# make extras  the optional parts, which `polhode doctor` lists: more solvers, bags and videos, convex pieces, ...
# make docs    the documentation as a site, in site/, with its internal links checked; it is read without a network
# make docs-links    whether the links that leave the site still answer, which needs a network
# make fusion-peers    Open3D and pycolmap, 500 MB, which two benchmarks compare with; without them their rows are missing
# make sbom    dist/polhode.cdx.json: the software bill of materials, in CycloneDX's JSON (docs/security.md)
# make release    sdist, wheel, notes, bill of materials and checksums of the tagged commit, in dist/ (docs/release.md);
#              make release OPTIONS="--dry-run --offline" tries it without a tag
# make bench   every benchmark, hours. What was measured before is read from its record, so that it can be
#              interrupted. make bench SHORT=--short: a short form of each, minutes. make bench-TOPIC: those of a topic
#              or of a name; python -m lab --list shows them

PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
SOLVERS := .venv/.solvers
SBOM := .venv/.sbom
SITE := .venv/.site
TEST_PACKAGES := .venv/.test_packages
TESTED := .venv/.tested
TEST_EXTRAS := browser,docs,export,formats,import,notebook,pandas,peers,sbom,solvers,view
DEMO_RUN := runs/demo
SHORT ?=
OPTIONS ?=
EXTRAS ?= [dev]
JOBS ?= 2

# What pip would take for PyTorch, as JSON; a build with CUDA requires NVIDIA's packages.
TORCH_OFFERED = $(BIN)/python -m pip install --quiet --dry-run --no-deps --ignore-installed \
    --constraint constraints.txt --report - torch 2> /dev/null

.PHONY: help setup setup-tests extras fusion-peers demo example test check docs docs-links sbom release bench
.DEFAULT_GOAL := setup

# The comment at the top of this file.
help:
	@sed -n '/^$$/q; s/^# \{0,1\}//p' $(firstword $(MAKEFILE_LIST))

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "polhode: error: $(PYTHON) is older than 3.11; give a newer one: make setup PYTHON=python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	    { echo "polhode: error: $(PYTHON) cannot make environments; on Debian: apt-get install python3-venv" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@if $(TORCH_OFFERED) | grep -Eq '"(nvidia|cuda|triton)'; then \
	    echo "installing some 6.4 GB of packages into .venv: the package index offers PyTorch with CUDA. With PyTorch's"; \
	    echo "CPU build it is 2 GB: interrupt, and give pip the index of CPU builds that pytorch.org names under"; \
	    echo "'Start locally': PIP_EXTRA_INDEX_URL=ADDRESS make setup"; \
	else echo "installing some 2 GB of packages into .venv, with PyTorch's CPU build, in one to three minutes"; fi
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.$(EXTRAS)'
	@echo '$(EXTRAS)' > $@

$(SOLVERS): $(STAMP)
	@grep -qs solvers $(STAMP) || \
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[solvers]'
	@touch $@

$(SBOM): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[sbom]'
	@touch $@

# The stamp of the first installation lists what came with it.
$(SITE): $(STAMP)
	@grep -qs docs $(STAMP) || \
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	@touch $@

$(TEST_PACKAGES): $(STAMP)
	@grep -qsF '$(TEST_EXTRAS)' $(STAMP) || \
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[$(TEST_EXTRAS)]'
	@touch $@

# What the tests need, among it programs that must accept what `polhode export` writes. Drake reads SDF with Gazebo's
# parser; it asks for a commercial solver, which reading needs not. The validator of glTF is there where npm is; its
# test says so.
$(TESTED): $(TEST_PACKAGES)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-deps drake || \
	    echo "polhode: Drake is not installed here: its tests are skipped" >&2
	@command -v npm > /dev/null && npm install --silent --no-fund --no-audit --prefix .venv/gltf \
	    gltf-validator@2.0.0-dev.3.10 || echo "polhode: no npm: the test of the glTF validator is skipped" >&2
	@touch $@

# One installation of all of it: every further one would look for all versions again, for half a minute each.
setup-tests: EXTRAS := [dev,$(TEST_EXTRAS)]
setup-tests: $(TESTED)


extras: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[export,import,pandas,solvers,train,view]'

fusion-peers: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[mapping-peers]'

demo: setup
	$(BIN)/polhode run configs/default.yaml --data examples/sample -o $(DEMO_RUN) --overwrite
	$(BIN)/polhode evaluate $(DEMO_RUN) examples/sample
	@echo "Demo done. Open $(DEMO_RUN)/report.html"

example:
	test -f $(DEMO_RUN)/mesh.ply || $(MAKE) demo
	$(BIN)/python -m examples.inspect_tumbling $(DEMO_RUN) examples/sample -o runs/flight

test: setup $(TESTED)
	$(BIN)/python -m pytest --numprocesses $(JOBS) --dist worksteal

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

# Material for MkDocs announces other programs at every start.
docs: setup $(SITE)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

docs-links: setup $(SITE)
	$(BIN)/python -m docs.website.external_links

sbom: setup $(SBOM)
	$(BIN)/python -m lab.release.bill_of_materials dist/polhode.cdx.json

release: setup $(SBOM)
	@$(BIN)/python -m lab.release $(OPTIONS)

bench: setup $(SOLVERS)
	$(BIN)/python -m lab $(SHORT)

bench-%: setup $(SOLVERS)
	$(BIN)/python -m lab $* $(SHORT)
