# `make demo` and `make test` set up everything they need: a virtual environment, the packages, and the system
# libraries that Open3D loads. Python >= 3.11 with its venv module is all they start from. For an NVIDIA GPU:
# `make demo EXTRAS=cuda13`, or cuda12, by the CUDA version that the driver supports.

VENV ?= .venv
EXTRAS ?=
PYTHON ?= $(firstword $(foreach name,python3 python3.14 python3.13 python3.12 python3.11,$(shell \
	$(name) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $(name))) python3)
BIN := $(VENV)/bin
comma := ,
INSTALLED := $(VENV)/.installed$(subst $(comma),-,$(EXTRAS:%=-%))
PYTHONS ?= 3.11 3.12 3.13 3.14
MATRIX_TESTS ?= tests/rasterizer
IN_PARALLEL := --numprocesses auto --dist loadfile --no-loadscope-reorder
OPEN3D_LIBRARIES := libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1 libidn2-0

.PHONY: demo ready test test-all check lint docs wheel oldest matrix rasterizer measure words libraries clean

demo: $(INSTALLED)
	$(BIN)/gsjax demo --out runs/demo

test: lint
	$(BIN)/python -m pytest $(IN_PARALLEL)

# All that tests and documentation need, before both run at once.
ready: $(INSTALLED)-test $(INSTALLED)-docs

# Those as well that compile for long to say of another case what a shorter test says: before a release, and by night.
test-all: lint
	$(BIN)/python -m pytest $(IN_PARALLEL) --long

# What one runs while working: all but the files that compile much.
check: lint
	$(BIN)/python -m pytest $(IN_PARALLEL) --quick

lint: $(INSTALLED)-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@if $(BIN)/pyright --version >/dev/null 2>&1; then echo $(BIN)/pyright; $(BIN)/pyright --pythonpath $(BIN)/python; \
	else echo "pyright cannot start on this machine: types are not checked"; fi

docs: $(INSTALLED)-docs
	$(BIN)/mkdocs build --strict

# The package as others install it: built, put into a folder outside the checkout, and asked from there.
wheel: $(INSTALLED)
	@folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && root=$$PWD && \
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir "$$folder" . && \
	$(BIN)/python -m pip install --quiet --no-deps --target "$$folder/installed" "$$folder"/*.whl && \
	python=$$(cd $(BIN) && pwd)/python && cd "$$folder" && \
	PYTHONPATH="$$folder/installed" "$$python" "$$root/tests/installed_wheel.py" "$$root"

# The tests with the oldest jax and optax that pyproject.toml allows.
oldest: $(INSTALLED)-test
	$(BIN)/python -m pip install --quiet $(shell sed -nE 's/^ *"(jax|optax)>=([0-9.]+).*/\1==\2/p' pyproject.toml)
	$(BIN)/python -m pytest $(IN_PARALLEL)

# The tests of the rasterizer, on each Python of this machine with the newest jax that pyproject.toml lets it take.
matrix:
	@failed=; for version in $(PYTHONS); do \
		python=$$(for name in python$$version "$$HOME"/.pyenv/versions/$$version.*/bin/python; do \
			"$$name" -c 'import venv' >/dev/null 2>&1 && echo "$$name" && break; done); \
		if [ -z "$$python" ]; then echo "Python $$version: not on this machine"; continue; fi; \
		$(MAKE) --no-print-directory VENV=$(VENV)-$$version PYTHON="$$python" rasterizer \
		|| failed="$$failed $$version"; \
	done; [ -z "$$failed" ] || { echo "failed on Python$$failed" >&2; exit 1; }

rasterizer: $(INSTALLED)-test
	@$(BIN)/python -c 'import jax, platform; print("Python", platform.python_version(), "with jax", jax.__version__)'
	$(BIN)/python -m pytest $(IN_PARALLEL) $(MATRIX_TESTS)

# The result files whose tables the pages have, in some hours on two cores. What is there of the same product is not run
# again. DATA holds the scenes fox, fern, kitchen, bunny_plane, and the photos of the room with its truth.
DATA ?= ../shared/data
MEASURED = runs/measured/$(shell git rev-parse --short HEAD:gsjax)

measure: $(INSTALLED)-test
	$(BIN)/python -m pytest tests/rasterizer/test_edge_cases.py -n 0 --long --hard-cases experiments/results/hard_cases.md
	test -e $(MEASURED)/demo || $(BIN)/gsjax demo --out $(MEASURED)/demo
	test -e $(MEASURED)/room || $(BIN)/gsjax sfm $(DATA)/room/images --out $(MEASURED)/room
	$(BIN)/python experiments/effect_detection.py \
		--scene fern=$(DATA)/fern/undistorted@2 built_in=$(MEASURED)/demo/scene bunny=$(DATA)/bunny_plane
	$(BIN)/python experiments/accuracy_vs_time.py --out $(MEASURED)/presets --scene room=$(MEASURED)/room@2 \
		fox=$(DATA)/fox/undistorted kitchen=$(DATA)/kitchen bunny=$(DATA)/bunny_plane
	$(BIN)/python experiments/compare.py ablation --scene $(MEASURED)/demo/scene --out $(MEASURED)/ablation --seeds 3 --record
	$(BIN)/python experiments/compare.py settings --scene $(MEASURED)/demo/scene --out $(MEASURED)/settings --seeds 3 --record

# What Open3D loads from the system, for who installs it otherwise.
libraries:
	@echo $(OPEN3D_LIBRARIES)

# How much there is to read: words and numbers, without the bars of tables.
words:
	@find README.md docs -name '*.md' | sort | xargs awk '{ gsub(/[|]/, " "); \
	for (i = 1; i <= NF; i++) if ($$i ~ /[[:alnum:]]/) { count[FILENAME]++; all++ } } \
	END { for (page in count) printf "%7d %s\n", count[page], page | "sort -k2"; close("sort -k2"); \
	printf "%7d in all\n", all }'

clean:
	rm -rf $(VENV) $(PYTHONS:%=$(VENV)-%) site dist build .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# A stamp is newer than pyproject.toml where what it asks for is installed.
$(INSTALLED): $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[all$(EXTRAS:%=,%)]'
	@$(load_open3d)
	@touch $@

$(INSTALLED)-test: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --editable '.[all,test,dev]'
	@touch $@

$(INSTALLED)-docs: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --editable '.[all,docs]'
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	|| { echo "Python 3.11 or newer is needed; name yours: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) \
	|| { rm -rf $(VENV); echo "Python's venv module is needed; type: sudo apt-get install python3-venv" >&2; exit 1; }

# Open3D's wheel loads these from the system; only root can put them there.
define load_open3d
if $(BIN)/python -c 'import open3d' 2>/dev/null; then exit 0; fi; \
if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
	apt-get install -qq -y --no-install-recommends $(OPEN3D_LIBRARIES) >/dev/null; \
	$(BIN)/python -c 'import open3d'; \
else \
	echo "Open3D cannot load its system libraries; type: sudo apt-get install $(OPEN3D_LIBRARIES)" >&2; exit 1; \
fi
endef
