# Both targets set up .venv from nothing and install into it again only when a source file has changed.
PYTHON ?= python3
BIN := .venv/bin
CXX_FILES := $(shell find csrc -name '*.h' -o -name '*.inl' -o -name '*.cpp')
SOURCES := pyproject.toml constraints.txt CMakeLists.txt README.md \
           $(shell find src cli csrc -not -path '*/__pycache__*' -not -name '*.pyc')

.PHONY: demo test

demo: .venv/installed
	$(BIN)/nmbg demo out/demo --overwrite

test: .venv/installed-with-tests
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/clang-format --dry-run --Werror $(CXX_FILES)
	$(BIN)/mypy -p nmbg
	$(BIN)/pytest

.venv/bin/pip:
	$(PYTHON) -m venv .venv

.venv/installed: $(SOURCES) | .venv/bin/pip
	$(BIN)/pip install --constraint constraints.txt .
	touch $@

.venv/installed-with-tests: $(SOURCES) | .venv/bin/pip
	$(BIN)/pip install --constraint constraints.txt '.[test]'
	touch .venv/installed $@
