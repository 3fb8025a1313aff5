# midspan: `make demo` shows the main job, `make test` runs all checks. Both set up what they need.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# What running midspan needs, and besides it what its checks need.
STAMP  := $(VENV)/.ready
DEV    := $(VENV)/.ready-for-tests
# Two processes of tests share the cores: no threads of the libraries besides. What is compiled is kept, whatever the
# environment says: the tests start the command some hundred times.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=
CORE   := core/Cargo.toml $(shell find core/src -name '*.rs')
# The page as the server sends it.
PAGE   := src/midspan/serve/page/index.html
WEB    := $(wildcard web/*.json web/*.html web/*.ts) $(shell find web/src web/public -type f)

# What the environment is made of.
PARTS  := pyproject.toml constraints.txt constraints-dev.txt tools/setup.sh tools/needs.sh $(CORE)

.PHONY: demo test check servers core-check static page docs reference bench live faults fuzz slow wheel container lock audit clean setup

demo: $(STAMP)
	$(BIN)/midspan demo -o demo

test: check

# Packages are fetched and types are checked on one core at a time: the core's own tests are built next to that.
check:
	$(MAKE) -j 4 servers core-check static
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

servers:
	sh tools/servers.sh

core-check:
	sh tools/core.sh check

static: $(DEV) $(PAGE)
	VENV="$(VENV)" sh tools/page.sh check
	$(BIN)/ruff format --check src tests benchmarks examples
	$(BIN)/ruff check src tests benchmarks examples
	$(BIN)/mypy
	$(BIN)/lint-imports

# What `make test` shows, again with more seeds, sizes and sensors, and the papers' claims that take minutes.
slow: $(DEV) $(PAGE) servers
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2 --dist worksteal -m slow

# The documentation as a site in site/; a link that leads nowhere fails.
docs: $(DEV)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

# The pages of all keys and commands, from the settings and the command line.
reference: $(DEV)
	$(BIN)/python tools/reference.py

bench: $(DEV)
	$(BIN)/python -m benchmarks

# Three points through an RTSP camera, an MQTT broker and the store, on loopback.
live: $(DEV) $(PAGE) servers
	$(BIN)/python -m benchmarks.live.show

# What can go wrong with cameras, sensors, broker and store, one after another: reason, recovery, band.
faults: $(DEV) servers
	$(BIN)/python -m benchmarks.live.faults

# 10 000 damaged files, settings and results: about 49 readers with 210 inputs each.
fuzz: $(DEV)
	PYTHONPATH=tests:tests/sources $(BIN)/python -m fuzz --inputs 210

setup: $(DEV) $(PAGE)

# The page of the live site, which `midspan run` and `midspan serve` send.
page: $(PAGE)

$(STAMP): $(PARTS)
	PYTHON="$(PYTHON)" VENV="$(VENV)" sh tools/setup.sh
	@touch $(STAMP)

# All in one go: midspan is built once.
$(DEV): $(PARTS)
	PYTHON="$(PYTHON)" VENV="$(VENV)" sh tools/setup.sh dev
	@touch $(STAMP) $(DEV)

$(PAGE): tools/page.sh $(WEB) | $(DEV)
	VENV="$(VENV)" sh tools/page.sh build

# The wheel for every Python from 3.11 on and the source distribution, in dist/; the wheel is tried without a compiler.
wheel: $(DEV) $(PAGE)
	BIN="$(BIN)" sh tools/wheel.sh

# An image with midspan alone, where podman or docker can build one; else the Containerfile is checked.
container:
	PYTHON="$(PYTHON)" sh tools/container.sh

# Renew the pinned versions, what users get apart from the developers' tools: names and versions only, no addresses.
lock: $(DEV)
	$(BIN)/python -m pip install --upgrade --upgrade-strategy eager -e '.[dev]'
	$(BIN)/python tools/pins.py

# Look the pinned versions up in the published advisories; needs a network, and is no part of `make test`.
audit:
	PYTHON="$(PYTHON)" sh tools/audit.sh

clean:
	rm -rf $(VENV) .audit-venv demo site dist core/target web/node_modules web/build src/midspan/serve/page .mypy_cache .ruff_cache .pytest_cache .hypothesis
