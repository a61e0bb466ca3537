# Everything here needs Python 3.11 or newer with its venv module, and make.
# The first target that is made builds .venv; later ones use it as it is. An older default Python:
#     make PYTHON=python3.12 test

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet
READY := $(VENV)/ready
FIGAROH := .venv-figaroh
NUMPYRO := .venv-numpyro
RELEASE := .venv-release
DOCS := .venv-docs

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow bench lint docs release-check clean

help:
	@echo "make demo       identify an embedded example robot and write a report"
	@echo "make test       the test suite"
	@echo "make test-slow  long statistical studies"
	@echo "make bench      speed and memory, also against FIGAROH (its own environment, $(FIGAROH))"
	@echo "                and the samplers, also against numpyro's NUTS ($(NUMPYRO))"
	@echo "make lint       ruff, pyright and the layers of imports"
	@echo "make docs       the documentation as web pages, in build/docs"
	@echo "make release-check  wheel and sdist, each tried in an empty environment of each Python that is there"
	@echo "make clean      remove all environments and everything built"

demo: $(READY)
	$(BIN)/bayesid demo

# A process a core, each with one thread: threads of two processes would wait for each other. A module stays in one process,
# so that what its tests share is made once. What Python has compiled is kept, even where the environment forbids that: else every
# process that a test starts compiles the package again.
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test: $(READY)
	$(PYTEST)

test-slow: $(READY)
	$(PYTEST) -m slow

bench: $(READY) $(FIGAROH)/ready $(NUMPYRO)/ready
	$(BIN)/python tests/benchmarks/run.py
	$(BIN)/python tests/benchmarks/identify.py
	$(BIN)/python tests/benchmarks/posterior_speed.py
	$(BIN)/python tests/benchmarks/diagnosis.py
	$(BIN)/python tests/benchmarks/startup.py
	$(BIN)/python tests/benchmarks/beside.py

# A warning is an error; nothing is fetched from a network.
docs: $(DOCS)/ready
	$(DOCS)/bin/sphinx-build --fail-on-warning --fresh-env -c docs -b html . build/docs
	@echo "open build/docs/docs/index.html"

lint: $(READY)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright
	$(BIN)/lint-imports

# Newest versions of everything, as `pip install bayesid` takes them: constraints.txt is for the tests. On 3.11, 3.12 and 3.13,
# as far as they are there, or on those named: make PYTHONS="python3.12 /opt/python3.13/bin/python" release-check
release-check:
	PYTHONS="$(PYTHONS)" tests/release.sh $(RELEASE)

clean:
	rm -rf $(VENV) $(FIGAROH) $(NUMPYRO) $(RELEASE) $(DOCS) build dist bayesid.egg-info

# An environment that was left half made, or whose Python is gone, is made anew.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is too old or missing: bayesid needs Python 3.11 or newer; name one: make PYTHON=python3.12 ..." >&2; exit 1; }
	@echo "Installing bayesid into $(VENV); this happens once and takes a minute or two."
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@$(PIP) --upgrade 'pip>=25.1'  # the first that knows dependency groups
	$(PIP) --constraint constraints.txt --editable . --group dev
	@touch $@

$(DOCS)/ready: pyproject.toml constraints.txt
	@$(DOCS)/bin/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(DOCS)
	@$(DOCS)/bin/python -m pip --disable-pip-version-check install --quiet --upgrade 'pip>=25.1'
	$(DOCS)/bin/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt --editable . --group docs
	@touch $@

$(FIGAROH)/ready:
	@$(FIGAROH)/bin/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(FIGAROH)
	$(FIGAROH)/bin/python -m pip --disable-pip-version-check install --quiet figaroh==1.0.2 pin==4.1.0 numpy==2.4.6 scipy==1.17.1
	@touch $@

$(NUMPYRO)/ready:
	@$(NUMPYRO)/bin/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(NUMPYRO)
	$(NUMPYRO)/bin/python -m pip --disable-pip-version-check install --quiet numpyro==0.22.0 jax==0.10.2 numpy==2.4.6 scipy==1.17.1
	@touch $@
