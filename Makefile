# Everything a fresh machine needs: git, make and Python 3.11 or newer.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PAGE   := ikservo/apps/page/static
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Tests start hundreds of commands; without bytecode each would compile the program anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all test-interpreted test-oldest check check-release campaign mutate bench build docs sanitize pictures lerobot vendor clean

demo: build  ## move the simulated SO-101 to a coordinate and print the report
	@$(BIN)/ikservo move 0.25 0.05 0.15 --arm so101 --port sim --yes

# What takes minutes, not hours, with interpreted kernels.
INTERPRETED = tests/guard/test_way_search.py tests/guard/test_collision_kernel.py \
	tests/guard/test_clear_space.py tests/arm/test_ways_around.py

# Arms of the browser tests move in real time beside the page that is drawn: one at a time.
test: $(VENV)/tested build  ## for every save: the tests that take little time, on every core
	$(BIN)/python -m pytest -n auto --dist worksteal --ignore tests/browser
	$(BIN)/python -m pytest -n 0 -m smoke tests/browser

test-all: $(VENV)/tested build  ## before a commit: all tests but the campaigns
	$(BIN)/python -m pytest -n auto --dist worksteal --all --ignore tests/browser
	$(BIN)/python -m pytest -n 0 tests/browser

check: $(VENV)/checked  ## what a commit must pass besides the tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/codespell
	$(BIN)/python tools/style_figures.py --check

test-interpreted: $(VENV)/tested  ## kernels and ways around run as Python, as without a C compiler
	IKSERVO_COMPILED=0 $(BIN)/python -m pytest -n auto --timeout 1800 $(INTERPRETED)

test-oldest:  ## a part of the suite with every dependency at its lowest version; needs uv
	tools/test_oldest.sh

check-release: $(VENV)/releasable  ## wheel, sdist, workflows, forms and citation against their schemas
	tools/check_release.sh $(BIN)

build: $(VENV)/installed  ## compile the kernels where they have changed; says whether they are compiled
	@$(BIN)/python tools/kernel/build_kernels.py

docs: $(VENV)/documented  ## the documentation site in site/, with every link checked
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "site/index.html"

sanitize: $(VENV)/tested  ## the kernels' tests with checked indices and sanitizers
	$(BIN)/python tools/kernel/sanitize.py

campaign: $(VENV)/tested build  ## long seeded campaigns, and every case that the suite leaves out
	$(BIN)/python -m pytest -m campaign
	$(BIN)/python -m pytest --all -m hypothesis --hypothesis-profile explore

MUTANTS ?= "ikservo.guard.*"
mutate: $(VENV)/mutating build  ## small changes of guard, kinematics or calibration (MUTANTS=) must make a test fail
	$(BIN)/mutmut run $(MUTANTS)
	$(BIN)/mutmut results

bench: $(VENV)/tested build  ## how long the commands take; results belong in docs/benchmarks.md
	$(BIN)/python tools/bench/startup.py

pictures: $(VENV)/tested build  ## the pictures of README and docs; those of the page by way of its browser tests
	IKSERVO_PICTURES=docs/pictures $(BIN)/python -m pytest -m browser tests/browser/test_browser_pictures.py
	$(BIN)/python tools/lecture_pictures.py
	$(BIN)/python tools/wiring_drawings.py

LEROBOT ?= lerobot[core-scripts,dataset,gamepad,viz]
lerobot: .venv-lerobot/installed  ## LeRobot's own commands on simulated arms; installs LeRobot for this Python, some GB
	.venv-lerobot/bin/python -m pytest -c integrations/lerobot/pyproject.toml integrations/lerobot/tests

.venv-lerobot/installed: pyproject.toml integrations/lerobot/pyproject.toml
	$(PYTHON) -m venv .venv-lerobot
	.venv-lerobot/bin/pip install --quiet "$(LEROBOT)" pynput pytest
	.venv-lerobot/bin/pip install --quiet --editable '.[view]' --editable integrations/lerobot "setuptools<82"
	@touch $@

vendor:  ## three.js and uPlot of the page anew, from npm at the versions of tools/vendor; needs node and npm
	cd tools/vendor && npm ci --no-fund --no-audit && npm run build
	cp tools/vendor/node_modules/three/LICENSE $(PAGE)/three.LICENSE.txt
	cp tools/vendor/node_modules/uplot/LICENSE $(PAGE)/uplot.LICENSE.txt
	cp tools/vendor/node_modules/uplot/dist/uPlot.min.css $(PAGE)/uplot.min.css
	cd $(PAGE) && sha256sum three.min.js > three.min.js.sha256
	cd $(PAGE) && sha256sum uplot.min.js uplot.min.css > uplot.min.js.sha256

clean:
	rm -rf $(VENV) .venv-lerobot build dist site mutants ikservo/kernels/_compiled.*

$(VENV)/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "ikservo needs Python 3.11 or newer; try: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) tools/check_machine.py
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade "pip>=25.1"

$(VENV)/installed: $(VENV)/bin/pip pyproject.toml
	$(BIN)/pip install --quiet --editable . "setuptools>=70"
	@touch $@

$(VENV)/tested: $(VENV)/installed
	$(BIN)/pip install --quiet --group test
	@touch $@

$(VENV)/checked: $(VENV)/tested
	$(BIN)/pip install --quiet --group check
	@touch $@

$(VENV)/mutating: $(VENV)/tested
	$(BIN)/pip install --quiet --group mutate
	@touch $@

$(VENV)/releasable: $(VENV)/bin/pip pyproject.toml
	$(BIN)/pip install --quiet --group release
	@touch $@

$(VENV)/documented: $(VENV)/tested
	$(BIN)/pip install --quiet --group docs
	@touch $@
