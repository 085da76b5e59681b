# Every target makes the virtual environment it needs in .venv, and makes it anew when pyproject.toml changes. Tests, lint and docs share one.
# Another interpreter: make test PYTHON=/path/to/python3.12     Fewer tests: make test ARGS="-k friction"

CANDIDATES := python3 python3.14 python3.13 python3.12 python3.11 python
NEW_ENOUGH := import sys; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(firstword $(foreach p,$(CANDIDATES),$(shell $(p) -c '$(NEW_ENOUGH)' >/dev/null 2>&1 && echo $(p))) python3)

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# INSTALLER=uv: uv unpacks in ten seconds what pip unpacks in eighty. It reads none of pip's settings (a mirror, a folder of wheels): pip
# goes on where uv cannot be had or does not find everything.
INSTALLER ?= pip
UV = $(PIP) uv && $(BIN)/uv pip install --quiet --python $(BIN)/python
install = { { [ $(INSTALLER) = uv ] && $(UV) --editable '$(1)'; } 2>/dev/null || $(PIP) --editable '$(1)'; }
# What pip installs is compiled on all cores; pip itself takes one, for a third of its time. The tests of other programs are a quarter of it,
# and nobody imports them.
COMPILE := $(BIN)/python -m compileall -qq -j 0 -x 'site-packages/.*/tests?/' $(VENV)/lib || true
WORKERS ?= 2
ARGS ?=

.DEFAULT_GOAL := help
.PHONY: help demo test test-rest lint docs bench clean
.NOTPARALLEL: # two installs into one environment would trip over each other
.DELETE_ON_ERROR:

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-9s %s\n", $$1, $$2}' Makefile

demo: $(VENV)/.installed ## install greybox and run its demonstration
	$(BIN)/greybox demo $(ARGS)

# One thread for BLAS: the matrices are 4x4, and a thread pool costs a hundred times the arithmetic.
test test-rest docs: export OMP_NUM_THREADS = 1
test test-rest docs: export OPENBLAS_NUM_THREADS = 1
# Hundreds of processes that tests start would each compile the sources anew where the environment forbids to keep what was compiled.
unexport PYTHONDONTWRITEBYTECODE
# A file's tests share what is dear (a fit, a search, a page in the browser that each goes on with): one worker has them all.
test: $(VENV)/.installed-dev ## run the everyday tests, in six minutes (the studies: make test ARGS="-m slow")
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(ARGS)

test-rest: $(VENV)/.installed-dev ## run the others: whole searches, browser, compilers, clusters, pages that are run
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m "rest and not slow" $(ARGS)

lint: $(VENV)/.installed-dev ## check style, format and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: export NO_MKDOCS_2_WARNING = 1 # an advertisement
# The studies of the gallery are most of the work, and each is a run by itself: all cores, five of them in a process, which imports for a second.
docs: $(VENV)/.installed-dev ## build the documentation into site/, warnings are errors
	@ls docs/gallery/*.md | xargs -n 5 -P $(WORKERS) $(BIN)/python docs/hooks.py
	$(BIN)/python -m mkdocs build --strict $(ARGS)

bench: export OMP_NUM_THREADS = 1
bench: export OPENBLAS_NUM_THREADS = 1
# An environment of its own: the other programs hold numerical libraries back that tests and types are checked with.
bench: ## time fits against other programs (bench.json, docs/studies/speed.md; some minutes)
	@$(MAKE) --no-print-directory VENV=.venv-bench .venv-bench/.installed-bench
	.venv-bench/bin/python -m fits.benchmarks.bench $(ARGS)

clean: ## remove the environment, builds and caches
	rm -rf $(VENV) .venv-bench build dist site .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamp comes last: an environment that was left half made is made again.
$(VENV)/.made:
	@$(PYTHON) -c '$(NEW_ENOUGH)' 2>/dev/null || { \
		echo "greybox needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version 2>/dev/null || echo not there)." \
		"Install one, or name it: make $(MAKECMDGOALS) PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -m venv --clear $(VENV) || { echo "'$(PYTHON) -m venv' failed; on Debian and Ubuntu the package" \
		"python3-venv provides it" >&2; exit 1; }
	@touch $@

$(VENV)/.installed: pyproject.toml $(VENV)/.made
	@echo "installing greybox into $(VENV)"
	@$(call install,.) && { $(COMPILE); } && touch $@

$(VENV)/.installed-%: pyproject.toml $(VENV)/.made
	@echo "installing greybox[$*] into $(VENV)"
	@$(call install,.[$*]) && { $(COMPILE); } && touch $@
