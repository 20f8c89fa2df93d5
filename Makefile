# Everything sets itself up: `make demo` and `make test` need only Python 3.11 or newer, pip and make.
# Another interpreter: `make test PYTHON=python3.12` (it gets an environment of its own, .venv-3.12).

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= python3
PYTHON_VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
ifeq ($(PYTHON),python3)
VENV ?= .venv
else
VENV ?= .venv-$(PYTHON_VERSION)
endif
BIN := $(VENV)/bin
STAMPS := $(VENV)/stamps
PIP := $(BIN)/python -m pip --disable-pip-version-check
INSTALL := $(PIP) install --quiet --constraint constraints.txt
PROJECT := pyproject.toml constraints.txt

INSTRUCTION ?= go to the hydrant behind the cone
OUT ?= demo
ARGS ?=
# The wheels of ROS 2 bring a lark of their own, so they get an environment of their own. Robots in
# physics are driven there too with ROS2_EXTRAS=ros2,robot.
ROS2 := .venv-ros2
ROS2_EXTRAS ?= ros2
# Test processes. One holds up to 3 GB, so this is not the number of cores.
WORKERS ?= 2

.PHONY: help demo test test-all test-browser test-ros2 fuzz lint format types budget check bench build docs notebooks frozen clean

help: ## this list
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

demo: $(STAMPS)/viz ## follow a sentence with the shipped models and write pictures to demo/
	@$(BIN)/jaxlangnav follow "$(INSTRUCTION)" --out $(OUT) --gif $(ARGS)

test: $(STAMPS)/dev ## the quick tier of tests, WORKERS=2 at a time
	@$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

test-all: $(STAMPS)/dev ## every test, the slow ones too
	@$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder -m "" $(ARGS)

test-browser: $(STAMPS)/browser ## the page of serve in the Chromium of this system
	@$(BIN)/python -m pytest -m "" tests/test_serve_browser.py $(ARGS)

test-ros2: $(ROS2)/stamps/ros2 ## bags and the node live on loopback, in an environment of its own (Python 3.11)
	@$(ROS2)/bin/python -m pytest -m "" tests/test_robots_ros2_bags.py tests/test_robots_ros2_live.py $(ARGS)

fuzz: $(STAMPS)/dev ## damaged input at every door; ARGS="--minutes 60 --seed 7 --target world"
	@$(BIN)/python scripts/fuzz.py $(ARGS)

lint: $(STAMPS)/dev ## ruff: rules and format
	@$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(STAMPS)/dev ## mend what ruff can mend
	@$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(STAMPS)/dev ## pyright on the package, studies, benchmarks and scripts
	@$(BIN)/pyright --pythonpath $(BIN)/python

budget: $(STAMPS)/dev ## lines and files beside what pyproject.toml allows
	@$(BIN)/python scripts/house.py --budget

check: lint types budget test ## what continuous integration runs

bench: $(STAMPS)/bench ## speed against every baseline, as ratios; ARGS="--quick --json"
	@$(BIN)/python benchmarks $(ARGS)

build: $(STAMPS)/dev ## a wheel and a source archive in dist/
	@$(BIN)/python -m build

docs: $(STAMPS)/docs ## the documentation in site/, every link checked
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

notebooks: $(STAMPS)/notebook ## run the notebooks that are old (ARGS=--all: every one)
	@$(BIN)/python scripts/notebooks.py $(ARGS)

frozen: $(STAMPS)/notebook ## make anew what is old in notebooks, README and docs (ARGS=--check: say what)
	@$(BIN)/python scripts/frozen.py $(ARGS)

clean: ## remove the environments and what the tools left
	@rm -rf .venv .venv-* dist site build .pytest_cache .ruff_cache .hypothesis fuzz

# Environments. A stamp is written last, so an interrupted set-up is done again; a changed
# pyproject.toml or constraints.txt updates the environment in place.
$(STAMPS)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
	  echo "jaxlangnav needs Python 3.11 or newer; $(PYTHON) is $(or $(PYTHON_VERSION),not found)." \
	    "Name another one: make <target> PYTHON=python3.12" >&2
	  exit 2
	}
	if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then
	  echo "Creating $(VENV) ($$($(PYTHON) --version))"
	  # Some distributions ship venv without ensurepip, some ship neither: pip alone is enough.
	  $(PYTHON) -m venv --clear $(VENV) >/dev/null 2>&1 \
	    || { $(PYTHON) -m venv --clear --without-pip $(VENV) >/dev/null 2>&1 \
	         && $(PYTHON) -m pip --disable-pip-version-check --python $(BIN)/python install --quiet pip; } \
	    || { rm -rf $(VENV) $(VENV)-bootstrap \
	         && $(PYTHON) -m pip --disable-pip-version-check install --quiet \
	              --target $(VENV)-bootstrap virtualenv \
	         && PYTHONPATH=$(VENV)-bootstrap $(PYTHON) -m virtualenv --quiet $(VENV) \
	         && rm -rf $(VENV)-bootstrap; }
	fi
	mkdir -p $(@D) && touch $@

$(STAMPS)/viz: $(STAMPS)/python $(PROJECT)
	@echo "Installing jaxlangnav and its figures into $(VENV) (about a minute, once)"
	$(INSTALL) --editable '.[viz]'
	touch $@

$(STAMPS)/dev: $(STAMPS)/python $(PROJECT)
	@echo "Installing jaxlangnav with the development tools into $(VENV) (about a minute, once)"
	$(INSTALL) --editable '.[viz,dev]'
	mkdir -p $(@D) && touch $(STAMPS)/viz $@

$(STAMPS)/bench: $(STAMPS)/dev
	@echo "Installing the libraries that speed is compared with into $(VENV)"
	$(INSTALL) --editable '.[viz,dev,bench]'
	touch $@

$(STAMPS)/browser: $(STAMPS)/dev
	@echo "Installing what drives a browser into $(VENV)"
	$(INSTALL) --editable '.[viz,dev,browser]'
	touch $@

$(STAMPS)/docs: $(STAMPS)/dev
	@echo "Installing the documentation tools into $(VENV)"
	$(INSTALL) --editable '.[viz,dev,docs]'
	touch $@

$(STAMPS)/notebook: $(STAMPS)/dev
	@echo "Installing Jupyter's parts that run notebooks into $(VENV)"
	$(INSTALL) --editable '.[viz,dev,notebook]'
	touch $@

$(ROS2)/stamps/ros2: $(PROJECT)
	@$(MAKE) --no-print-directory VENV=$(ROS2) $(ROS2)/stamps/python
	echo "Installing jaxlangnav with the wheels of ROS 2 into $(ROS2) (about a minute, once)"
	$(ROS2)/bin/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt \
	  --editable '.[$(ROS2_EXTRAS)]' pytest
	touch $@
