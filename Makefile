# `make demo` and `make test` do all their own set-up in .venv; only Python 3.11 or newer is needed.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test docs clean databases kernels scenes

# What is imported is kept as bytecode, even where the environment forbids it: installing with --no-compile leaves none, and each
# of many processes would take a second longer.
export PYTHONDONTWRITEBYTECODE :=

demo: $(VENV)/.installed
	$(BIN)/spreadlets demo -o demo_output

test: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/python -m pytest
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m interpreted $$(grep -rl mark.interpreted tests)

# The documentation, as a site in site/.
docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build --strict

# The commands that regenerate the databases in psf_db/.
databases: $(VENV)/.installed
	$(BIN)/spreadlets build simplelens -o psf_db/simplelens.h5 --samples 400
	$(BIN)/spreadlets build combined -o psf_db/combined.h5 --samples 1000
	$(BIN)/spreadlets build volume -o psf_db/volume.h5 --width 512
	$(BIN)/spreadlets build stylized -o psf_db/stylized.h5 --image docs/models/heart.png --colour-offset 0.06 --samples 300
	$(BIN)/spreadlets build physicallens -o psf_db/physicallens.h5 --camera psf_db/physicallens.json --width 1024 \
	    --max-coc 32 --samples 500

# Which kernels a run calls, in which order: what other processes compile in the first run.
kernels: $(VENV)/.installed
	for run in synthesize reconstruct; do \
	    $(BIN)/python -m spreadlets.ahead $$run > $$run.json && mv $$run.json spreadlets/ahead/ || exit 1; \
	done

# The frames that studies take by --frames, in frames/: hours. For less: make scenes SCENES=gear SIZE=256 EFFORT=0.1
SCENES ?= coins whirl fence gear rain
SIZE ?= 512
EFFORT ?= 1
scenes: $(VENV)-scenes/.installed
	set -e; for scene in $(SCENES); do \
	    $(VENV)-scenes/bin/python scenes/render.py $$scene --size $(SIZE) --effort $(EFFORT) -o frames; done

# A Python's own pip may be years old; a new one takes half as long to choose among many versions.
$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit("spreadlets needs Python 3.11 or newer, not " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --upgrade pip

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[metrics]'
	touch $@

$(VENV)/.installed-dev: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[dev]'
	touch $(VENV)/.installed $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	touch $@

# Blender's package has its own Python, 3.11, and NumPy, 1.
PYTHON311 ?= python3.11

$(VENV)-scenes/.installed: pyproject.toml
	$(PYTHON311) -m venv $(VENV)-scenes
	$(VENV)-scenes/bin/python -m pip install --quiet --editable '.[scenes]'
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-scenes demo_output build dist site
