# lime_planner: `make demo` and `make test` set everything up themselves. `make help` says what else there is.
SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help setup setup-test setup-docs demo view test lint docs clean

BIN := .venv/bin
SCENE ?=
DEMO_ARGS ?=
VIEW_ARGS ?=
PYTEST_ARGS ?=
COVERAGE ?=

# The ROS wheels leave their library path to child processes; that of another environment must not reach this one's.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
endif
# What a shell says of bytecode is for its own programs: the tests start hundreds, which would compile all they import each time.
unexport PYTHONDONTWRITEBYTECODE
# A sourced ROS 2 is seen through PYTHONPATH; otherwise the environment stands alone.
ifndef ROS_DISTRO
unexport PYTHONPATH
endif

help:
	@echo "make demo                   a simulated Kinova arm reaches a lime inside a plant; ends with a table and a picture in out/"
	@echo "make demo SCENE=file.npz    the same for a scene of yours (also PLY, PCD); more options: DEMO_ARGS='--help'"
	@echo "make view                   the same nodes with a 3-D page to look at and to steer them from (SCENE=..., VIEW_ARGS='--port 8090')"
	@echo "make test                   ruff, mypy and all tests, after installing what they need (some: PYTEST_ARGS='-k name')"
	@echo "make test COVERAGE=1        the same with a table of covered lines, in twice the time"
	@echo "make lint                   ruff and mypy alone"
	@echo "make docs                   build the documentation into site/; its first page is site/index.html"
	@echo "make setup                  only what demo and view do first: system libraries, .venv, dependencies, compiling (PYTHON=... to choose one)"
	@echo "make clean                  remove .venv, builds, caches and out/"

setup:
	@PYTHON='$(PYTHON)' scripts/setup.sh

setup-test:
	@PYTHON='$(PYTHON)' scripts/setup.sh test

setup-docs:
	@PYTHON='$(PYTHON)' scripts/setup.sh docs

demo: setup
	@$(BIN)/python -m lime_planner demo $(if $(SCENE),--scene '$(SCENE)') $(DEMO_ARGS)

view: setup
	@$(BIN)/python -m lime_planner view --nodes $(if $(SCENE),'$(SCENE)') $(VIEW_ARGS)

lint: setup-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/mypy

test: lint
	@scripts/browser.sh
	@scripts/control_msgs.sh || echo "make test: the tests of controller: jtc_action will be skipped"
	@COVERAGE='$(COVERAGE)' scripts/tests.sh $(PYTEST_ARGS)

docs: setup-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "documentation: site/index.html"

clean:
	rm -rf .venv build install log out site dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
