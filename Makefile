# The two commands a newcomer needs: `make demo` and `make test`. Both set up .venv first, with the exact versions of constraints.txt.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK = 1
# Where this is set, every command that a test starts compiles all sources again.
export PYTHONDONTWRITEBYTECODE =

.PHONY: demo test test-all lint types gate wheel docs installs release clean

demo: $(VENV)/.installed
	$(BIN)/sabench run demo

# The daily tier: one small case of every law.
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"

# Everything: the daily tier, then the slow tests.
test-all: test
	$(BIN)/python -m pytest -n auto --dist worksteal -m slow

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

# No figure of the suite ci may be worse than in its baseline.
gate: $(VENV)/.installed
	$(BIN)/sabench check ci

# A wheel in a fresh environment must offer what the checkout offers.
wheel: $(VENV)/.installed
	rm -rf build/wheel
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/wheel/venv
	build/wheel/venv/bin/pip install --quiet --constraint constraints.txt "$$(echo build/wheel/*.whl)[full]"
	$(BIN)/sabench list > build/wheel/checkout.txt
	cd build/wheel && venv/bin/sabench list > wheel.txt
	diff build/wheel/checkout.txt build/wheel/wheel.txt && echo "wheel: sabench list equals the checkout's"

# The wheel in fresh environments of other interpreters: make installs PYTHONS="python3.12 python3.13"
installs: $(VENV)/.installed
	$(BIN)/python benchmarks/installs.py $(PYTHONS)

# All that a release must pass, and what a person has to look at.
release: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/release.py

# The site: warnings are errors, links are checked, nothing is loaded from the network.
docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -E -W --keep-going -q -c docs/site -d build/site-trees . build/site
	$(BIN)/python docs/site/check.py build/site

$(VENV)/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "sabench needs Python 3.11 or later: make PYTHON=/path/to/python3.11"; exit 2; }
	@echo "setting up $(VENV): a minute or two"
	$(PYTHON) -m venv $(VENV) || { echo "$(PYTHON) cannot make a virtual environment: on Debian and Ubuntu, apt install python3-venv"; exit 2; }

$(VENV)/.installed: $(VENV)/bin/pip pyproject.toml constraints.txt
	$(BIN)/pip install --constraint constraints.txt --editable '.[full]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/pip install --constraint constraints.txt --editable '.[dev]'
	@# without its dependencies: its opencv-python would overwrite opencv-python-headless and need libraries of a desktop
	$(BIN)/pip install --constraint constraints.txt --no-deps openlpt || echo "OpenLPT has no wheel for this machine: its tests are skipped"
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(BIN)/pip install --constraint constraints.txt --editable '.[docs]'
	@touch $@

clean:
	rm -rf $(VENV) build work
