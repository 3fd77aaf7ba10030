# make demo   sets up .venv and catches the swinging rope over ROS 2
# make test   sets up .venv and runs lint, types and tests
# make quick  sets up .venv and runs the pure tests of the nodes and the package: a minute
# make long   draws other problems: hours (CONTRIBUTING.md)
# make docs   writes the table of parameters and draws the pictures of docs/ anew
#
# PYTHON=... picks the interpreter, VENV=... the environment, PINS=... what pip is to keep to,
# JOBS=... how many test files run at a time. With ROS 2 installed (ROS_DISTRO is set) its Python
# packages are used, and NumPy stays below 2 if theirs is; elsewhere they come from PyPI.

PYTHON ?= python3
VENV ?= .venv
# More than two cores: for half of their time the tests over DDS wait for processes.
JOBS ?= 3
QUICK = ros_* package_* loop_* mpc_check* mpc_command mpc_problem mpc_geometry mpc_compensation
BIN = $(VENV)/bin
SAY = @printf '\n== %s\n'
# Without compiling: Python compiles what is imported, which is a small part of these packages.
INSTALL = $(BIN)/python -m pip install -q --disable-pip-version-check --no-compile
COMPILE = @$(BIN)/python -m orbimpc_ros.mpc.kernels

# The nodes of tests and demos are hundreds of processes: each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE

ifdef ROS_DISTRO
VENV_FLAGS = --system-site-packages
EXTRAS_DEMO = [fast]
EXTRAS_TEST = [fast,study,test]
NUMPY := $(shell $(PYTHON) -c 'import numpy; print(numpy.__version__)' 2>/dev/null)
PINS = $(if $(filter 1.%,$(NUMPY)),--constraint requirements-jazzy.txt)
else
EXTRAS_DEMO = [ros,fast]
EXTRAS_TEST = [ros,fast,study,test,view]
endif

.PHONY: demo test quick lint pytest long proofs questions docs clean help
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

demo: $(VENV)/.installed-demo
	$(SAY) 'Catching the rope: planner and simulator as two processes over DDS'
	$(BIN)/orbimpc demo retrieval

test: lint pytest

lint: $(VENV)/.installed-test
	$(SAY) 'Lint (ruff)'
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(SAY) 'Types (mypy)'
	$(BIN)/mypy

pytest: $(VENV)/.installed-test
	$(SAY) 'Tests (pytest)'
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile $(PYTEST_FLAGS)

quick: $(VENV)/.installed-test
	$(BIN)/python -m pytest --quick -n 2 $(wildcard $(QUICK:%=test/test_%.py))

long: proofs questions

proofs: $(VENV)/.installed-test
	ORBIMPC_SEEDS=1000:1020 $(BIN)/python -m pytest -n $(JOBS) \
		$(patsubst %,test/test_mpc_%.py,laws proof refute)

questions: $(VENV)/.installed-test
	ORBIMPC_LONG=1 $(BIN)/python -m pytest test/test_mpc_degenerate.py

docs: $(VENV)/.installed-demo
	$(SAY) 'Parameters and pictures'
	$(BIN)/python docs/parameters.py > docs/parameters.new
	mv docs/parameters.new docs/parameters.md
	$(BIN)/python docs/pictures.py

$(VENV)/.installed-demo: $(BIN)/python setup.py setup.cfg pyproject.toml requirements-jazzy.txt
	$(SAY) 'Installing orbimpc_ros into $(VENV) (some minutes, only once)'
	@$(INSTALL) --editable '.$(EXTRAS_DEMO)' $(PINS)
	@touch $@

$(VENV)/.installed-test: $(BIN)/python setup.py setup.cfg pyproject.toml requirements-jazzy.txt
	$(SAY) 'Installing orbimpc_ros and its test tools into $(VENV) (some minutes, only once)'
	@$(INSTALL) --editable '.$(EXTRAS_TEST)' $(PINS)
	$(COMPILE)
	@touch $@ $(VENV)/.installed-demo

$(BIN)/python:
	$(SAY) 'Creating $(VENV) with $(PYTHON)'
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' || { \
	  echo 'orbimpc_ros needs Python 3.10 to 3.13; $(PYTHON) is' \
	    "$$($(PYTHON) --version 2>&1 || echo missing). Try: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV_FLAGS) $(VENV) || { rm -rf $(VENV); \
	  echo 'The venv module is missing or broken. On Debian and Ubuntu: apt install python3-venv' >&2; exit 1; }

clean:
	rm -rf $(VENV) build install log dist *.egg-info out
