# make install  installs what running needs into .venv
# make demo     installs that, then runs the whole loop at a small size into runs/demo
# make test     installs what testing needs, too, then runs all but the slow tests
# make docs     builds the pages of the documentation into build/site
# make test-slow  runs the tests that take minutes each
# make model    trains the models that ship with the package again
# make release  builds what is published into dist: sdist, wheel, hash-pinned lock, bill of
#               materials, licences

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

# Many processes with one thread each are faster than a few that compete for the cores.
export OMP_NUM_THREADS ?= 1

# The kernels of a first use are compiled while the package is installed.
FIRST := --duration-s 20 --stream --predict --quiet > /dev/null

.PHONY: install demo test test-slow docs model release

install: $(VENV)/.installed

demo: $(VENV)/.installed
	$(BIN)/python -m experiments.demo

test: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -q -n auto --dist worksteal --doctest-modules \
	    tests behaviors sim graphrqi scenarios experiments

test-slow: $(VENV)/.installed-dev
	$(BIN)/pytest -q -m slow tests

docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

# Libraries choose instructions and the order of sums by the make of a processor, and the last bits of
# a result differ with them. Models are trained with those that every processor with AVX2 has: of
# numpy, PyTorch, OpenBLAS, MKL and numba, in this order.
ALIKE := NPY_DISABLE_CPU_FEATURES="X86_V4 AVX512_ICL AVX512_SPR" ATEN_CPU_CAPABILITY=avx2 \
    OPENBLAS_CORETYPE=Haswell MKL_CBWR=COMPATIBLE NUMBA_CPU_NAME=haswell

model: $(VENV)/.installed-dev
	$(ALIKE) $(BIN)/python -m experiments.model

$(BIN)/python:
	@$(PYTHON) -c 'import sys; (3, 11) <= sys.version_info[:2] <= (3, 13) or sys.exit("found Python %d.%d, expected 3.11 to 3.13: make PYTHON=/path/to/python3.11" % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP_INSTALL) --editable .
	$(BIN)/python -m experiments.cli run four_way_intersection $(FIRST)
	$(BIN)/python -m experiments.cli run four_way_intersection --engine highway $(FIRST)
	@touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP_INSTALL) --editable '.[dev]'
	$(BIN)/python -m experiments.cli run four_way_intersection $(FIRST)
	$(BIN)/python -m experiments.cli run four_way_intersection --engine highway $(FIRST)
	@touch $(VENV)/.installed $@

# The release tools live in an environment of their own, so that what they need is not locked.
release: $(VENV)/.installed $(VENV)-release/.installed
	rm -rf dist && mkdir dist
	$(VENV)-release/bin/python -m build --quiet --no-isolation --outdir dist .
	$(VENV)-release/bin/pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras \
	    --no-header --no-emit-options --no-emit-index-url --no-emit-trusted-host \
	    --no-emit-find-links --constraint constraints.txt --output-file dist/requirements.lock \
	    pyproject.toml
	$(VENV)-release/bin/cyclonedx-py requirements --output-reproducible --validate \
	    --pyproject pyproject.toml --output-file dist/sbom.cdx.json dist/requirements.lock
	$(VENV)-release/bin/pip-licenses --python $(BIN)/python --format markdown --order license \
	    --from mixed --with-urls --output-file dist/licences.md \
	    --packages $$(sed -n 's/^\([A-Za-z0-9._-]*\)==.*/\1/p' dist/requirements.lock)
	cd dist && sha256sum * > SHA256SUMS

$(VENV)-release/.installed: pyproject.toml constraints.txt | $(BIN)/python
	$(PYTHON) -m venv $(VENV)-release
	$(VENV)-release/bin/python -m pip install --quiet --disable-pip-version-check \
	    -c constraints.txt build cyclonedx-bom pip-licenses pip-tools setuptools
	@touch $@
