# Every target sets up what it needs; only Python (>= 3.10), pip and make must be there.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= out/demo
WORKERS ?= 2
# the seed of soak's examples: another number for each release; fresh: new ones in each run
DRAWS  ?= 20261122

.PHONY: help setup demo test soak agents browser lint bench docs dist

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

$(VENV)/.ready: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

setup: $(VENV)/.ready  ## make the environment

demo: $(VENV)/.ready  ## made scenes -> instructions -> episodes -> files, in minutes
	$(BIN)/condvln demo --out $(OUT)

lint: $(VENV)/.ready  ## style, types, the import contract, nothing newer than Python 3.10
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/vermin --quiet --no-tips --violations -t=3.10- schemas condvln factory jobs

test: lint  ## lint, types, contracts and tests (about a quarter of an hour on two cores)
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not soak"

soak: $(VENV)/.ready  ## full fuzzing, fault and determinism matrices
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "soak or costly" --draws $(DRAWS)
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "hypothesis and not soak and not costly" --draws $(DRAWS) --rounds 6

# Heavy packages, over those of $(VENV), in an environment of their own: their pins contradict those of the tests.
$(VENV)-agents/.ready: requirements-agents.lock $(VENV)/.ready
	$(PYTHON) -m venv $(VENV)-agents
	$(BIN)/python -c "import site; print(site.getsitepackages()[0])" > \
	  "$$($(VENV)-agents/bin/python -c 'import site; print(site.getsitepackages()[0])')/tests.pth"
	$(VENV)-agents/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements-agents.lock
	@touch $@

# torch's CPU build is not in every package index. Where pip does not find it, there is no stamp: the test of TRL is
# skipped, and the next run tries again.
$(VENV)-agents/.trl: requirements-trl.lock $(VENV)-agents/.ready
	$(VENV)-agents/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements-trl.lock && \
	  touch $@ || echo "requirements-trl.lock was not installed: the test of TRL will be skipped"

agents: $(VENV)-agents/.ready $(VENV)-agents/.trl  ## tests of the tools for language agents, each driven by its own package
	$(VENV)-agents/bin/python -m pip check
	$(VENV)-agents/bin/python -c "import inspect_ai, openenv, transformers"
	$(VENV)-agents/bin/python -m pytest -rs tests/condvln/evaluation/test_agent_packages.py tests/condvln/evaluation/test_learned_agent.py

browser: $(VENV)/.ready  ## tests of the explorer's page in a real Chromium
	tests/browser/install_chromium.sh
	CONDVLN_BROWSER=1 $(BIN)/python -m pytest -rs -s tests/browser

bench: $(VENV)/.ready  ## side-by-side measurements, ratios in one run
	$(BIN)/python -m benchmarks

docs: $(VENV)/.ready  ## the documentation site, built strictly and offline into out/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "open out/site/index.html"

dist: $(VENV)/.ready  ## the wheel and the source archive, in dist/
	rm -rf build
	$(BIN)/python -m build --outdir dist
	rm -rf build
