# Every target sets up what it needs, also on a fresh machine.
#
# With a GPU nothing changes: pip installs its default torch, which on Linux is the CUDA build.
# Another interpreter: make setup PYTHON=python3.12.  More options: make demo ARGS="--seed 1".
# Tests in one process, for a debugger: make test ARGS="-n 0".

PYTHON ?= python3
ARGS ?=
BIN := .venv/bin
GL_PACKAGES := libegl1 libegl-mesa0 libgl1-mesa-dri libosmesa6

.DEFAULT_GOAL := help
.PHONY: help setup gl demo test test-slow lint clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: .venv/.installed gl ## make .venv with everything in it, and check that it can render

demo: setup ## ground the pendulum's source in its hard target, on two CPU cores in minutes
	$(BIN)/idapt fit --config configs/pendulum_quick.yaml $(ARGS)

test: setup ## the tests, all but the slow ones
	$(BIN)/python -m pytest $(ARGS)

test-slow: setup ## the tests that train for minutes
	$(BIN)/python -m pytest -m slow $(ARGS)

lint: .venv/.installed ## ruff and mypy, as tests/test_lint.py runs them
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean: ## remove .venv and caches; runs stay
	rm -rf .venv build *.egg-info .pytest_cache .ruff_cache .mypy_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

.venv/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "Python 3.11 or newer is needed, $(PYTHON) is: $$($(PYTHON) --version 2>&1)." \
	       "Name another one: make setup PYTHON=python3.12" >&2; exit 1; }
	[ -x $(BIN)/pip ] || $(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet -e '.[dev]'
	@touch $@

gl: .venv/.installed
	@if [ -n "$$MUJOCO_GL" ] || $(BIN)/python -c 'import ctypes; ctypes.CDLL("libEGL.so.1")' 2>/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  apt-get update && apt-get install -y $(GL_PACKAGES); \
	else \
	  echo "Rendering without a screen needs EGL, which is missing here. On Debian or Ubuntu:" >&2; \
	  echo "  sudo apt-get install $(GL_PACKAGES)" >&2; \
	  echo "Then $(BIN)/idapt doctor says whether it works." >&2; \
	fi
