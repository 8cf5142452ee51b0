# SPDX-License-Identifier: GPL-3.0-or-later
# The two commands of the README are `make demo` and `make test`; each sets up what it needs. `make help` lists the rest.
SHELL := /bin/bash
.DEFAULT_GOAL := help

VENV := .venv
PY := $(VENV)/bin/python
TRAINING_VENV := .venv-training
CMAKE := $(VENV)/bin/cmake
SOURCES := $(shell find cpp/include cpp/src cpp/bindings cmake python -type f -not -name '*.so' -not -path '*/__pycache__/*') CMakeLists.txt pyproject.toml README.md
CPP_FILES := $(shell find cpp tests/cpp examples/cpp -name '*.cpp' -o -name '*.hpp')
DEMO_OUTPUT ?= demo-output
TRAINING_DATA ?= training-data
BENCH_ARGS ?=

.PHONY: weights bench-emulator bench-emulator-ablations bench-emulator-scenes bench-emulator-speed help setup demo test test-cpp test-python test-slow test-blender test-blender-versions test-training bench bench-bake bench-springs lint format types tidy sanitize extension wheel clean

help: ## List the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 24

$(VENV)/.tools: tools/setup.sh pyproject.toml
	@bash tools/setup.sh $(VENV)
	@touch $@

$(VENV)/.installed: $(VENV)/.tools $(SOURCES)
	@echo "Building and installing followthrough into $(VENV)"
	@wheel=$$($(PY) tools/built_wheel.py) && $(PY) -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$$wheel"
	@touch $@

setup: $(VENV)/.installed ## Make the virtual environment with everything in it; .venv/bin/followthrough is there afterwards

demo: setup ## Build, paint and bake the demo character; writes a .blend, a picture and a video to demo-output/
	@$(PY) tools/require_bpy.py
	@$(PY) examples/demo.py --output $(DEMO_OUTPUT)

test: test-cpp test-python test-blender ## All tests, the Blender ones in the virtual environment's bpy

test-cpp: $(VENV)/.tools
	@$(CMAKE) -S . -B build/tests -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(VENV)/bin/ninja -DPython_EXECUTABLE=$(CURDIR)/$(PY) \
	  -DFOLLOWTHROUGH_PYTHON=OFF -DFOLLOWTHROUGH_TESTS=ON -DFOLLOWTHROUGH_VALIDATE=ON > build-tests.log || { cat build-tests.log; rm -f build-tests.log; exit 1; }
	@rm -f build-tests.log
	@$(CMAKE) --build build/tests
	@$(VENV)/bin/ctest --test-dir build/tests --output-on-failure

test-python: setup
	@$(PY) -m pytest tests/python

test-slow: setup ## Tests that take minutes: ten thousand frames of violence for every quality of the elastic solvers
	@$(PY) -m pytest -m slow tests/python

test-blender: setup
	@$(PY) tools/require_bpy.py
	@bash tools/blender_tests.sh $(PY)

test-blender-versions: $(VENV)/.tools ## The Blender tests in bpy 4.2, 4.5, 5.0 (Python 3.11) and 5.2 (Python 3.13)
	@bash tools/test_blender_versions.sh

$(TRAINING_VENV)/.tools: tools/requirements.py pyproject.toml
	@[ -x $(TRAINING_VENV)/bin/python ] || "$$(bash tools/find_python.sh $(PYTHON))" -m venv $(TRAINING_VENV)
	@echo "Installing PyTorch and ONNX Runtime into $(TRAINING_VENV): minutes, and about 5 GB with the GPU libraries that PyPI's wheel wants"
	@$(TRAINING_VENV)/bin/python tools/requirements.py training benchmark test > $(TRAINING_VENV)/requirements.txt
	@$(TRAINING_VENV)/bin/python -m pip install --quiet --disable-pip-version-check -r $(TRAINING_VENV)/requirements.txt
	@touch $@

$(TRAINING_VENV)/.installed: $(TRAINING_VENV)/.tools $(SOURCES)
	@python=$(TRAINING_VENV)/bin/python; wheel=$$($$python tools/built_wheel.py) && \
	  $$python -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$$wheel"
	@touch $@

test-training: $(TRAINING_VENV)/.installed ## The tests that need PyTorch, in a virtual environment of its own (.venv-training)
	@$(TRAINING_VENV)/bin/python -m pytest tests/training

weights: setup $(TRAINING_VENV)/.installed ## Make the emulator's weights again from nothing: data (2 minutes of one core), training (17 to 23 minutes)
	@mkdir -p $(TRAINING_DATA)
	@$(VENV)/bin/followthrough dataset shapes --motions 240 --frames 90 --seed 2 --stiffness-range 0.7 4 -o $(TRAINING_DATA)/soft
	@$(VENV)/bin/followthrough dataset shapes --motions 160 --frames 90 --seed 1 -o $(TRAINING_DATA)/wide
	@OMP_NUM_THREADS=1 $(TRAINING_VENV)/bin/followthrough train $(TRAINING_DATA)/soft $(TRAINING_DATA)/wide -o $(TRAINING_DATA)/emulator.npz
	@mkdir -p python/followthrough/weights && cp $(TRAINING_DATA)/emulator.npz python/followthrough/weights/emulator.npz

bench-emulator: setup ## Errors and times of the emulator and of what could take its place, on dances that it has not seen
	@$(VENV)/bin/followthrough dataset held-out --motions 2 -o $(TRAINING_DATA)/held-out
	@OMP_NUM_THREADS=1 $(PY) cpp/bench/emulator_scores.py $(TRAINING_DATA)/held-out --pattern 'test-*'

bench-emulator-ablations: setup $(TRAINING_VENV)/.installed ## The paper's network without the reference motion, and with two and three rings: hours of training
	@$(VENV)/bin/followthrough dataset sphere --motions 16 --seed 1 -o $(TRAINING_DATA)/sphere
	@$(VENV)/bin/followthrough dataset sphere --motions 1 --seed 1001 -o $(TRAINING_DATA)/sphere-like
	@$(VENV)/bin/followthrough dataset held-out --motions 2 -o $(TRAINING_DATA)/held-out
	@OMP_NUM_THREADS=1 $(TRAINING_VENV)/bin/python cpp/bench/emulator_ablations.py $(TRAINING_DATA)/sphere --like $(TRAINING_DATA)/sphere-like \
	  --dances $(TRAINING_DATA)/held-out --pattern 'test-*' -o $(TRAINING_DATA)/ablations

bench-emulator-scenes: setup ## Errors and times of the emulator and the simulation on hard scenes, and how many meet the aims (a few minutes)
	@OMP_NUM_THREADS=1 $(PY) cpp/bench/emulator_scenes.py $(TRAINING_DATA)/scenes $(BENCH_ARGS)

bench-emulator-speed: $(TRAINING_VENV)/.installed ## Time of the emulator beside PyTorch, ONNX Runtime and the finite elements, by size
	@$(TRAINING_VENV)/bin/followthrough benchmark emulator $(BENCH_ARGS)

bench: setup ## Benchmarks of the core beside memory copy speed, and of the bake beside stepping the frames
	@bash tools/apt_require.sh libbenchmark-dev libopenblas0
	@$(CMAKE) -S . -B build/bench -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(VENV)/bin/ninja -DPython_EXECUTABLE=$(CURDIR)/$(PY) \
	  -DFOLLOWTHROUGH_PYTHON=OFF -DFOLLOWTHROUGH_BENCH=ON > /dev/null
	@$(CMAKE) --build build/bench
	@build/bench/followthrough_bench --benchmark_repetitions=5 --benchmark_enable_random_interleaving=true \
	  --benchmark_report_aggregates_only=true $(BENCH_ARGS)
	@$(MAKE) --no-print-directory bench-bake bench-springs

bench-springs: setup ## Learning 14,000 springs beside a straight Python implementation
	@$(PY) cpp/bench/spring_fit_time.py

bench-bake: setup ## Bake time over the time of merely stepping the same frames in Blender, and what the live preview takes
	@$(PY) tools/require_bpy.py
	@$(PY) cpp/bench/bake_time.py
	@$(PY) cpp/bench/preview_time.py

lint: $(VENV)/.tools types ## Check formatting, style, types and licence lines
	@$(VENV)/bin/ruff check python addon tests examples tools cpp
	@$(VENV)/bin/ruff format --check python addon tests examples tools cpp
	@$(VENV)/bin/clang-format --dry-run --Werror $(CPP_FILES)
	@$(PY) tools/check_licence_lines.py

types: $(VENV)/.tools
	@$(VENV)/bin/mypy

tidy: $(VENV)/.tools ## Static analysis of the C++ core
	@$(CMAKE) -S . -B build/tests -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(VENV)/bin/ninja -DPython_EXECUTABLE=$(CURDIR)/$(PY) \
	  -DFOLLOWTHROUGH_PYTHON=OFF -DFOLLOWTHROUGH_TESTS=ON -DFOLLOWTHROUGH_VALIDATE=ON > /dev/null
	@mkdir -p build/tests/openmp && ln -sf "$$(c++ -print-file-name=include)/omp.h" build/tests/openmp/  # the compiler's own: clang-tidy has none
	@find cpp/src -name '*.cpp' -not -name '*.kernel.cpp' -not -name '*.amx.cpp' -not -name '*.avx512_bf16.cpp' | xargs -P $$(nproc) -n 4 \
	  $(VENV)/bin/clang-tidy --quiet -p build/tests --extra-arg=-isystem$(CURDIR)/build/tests/openmp

format: $(VENV)/.tools ## Format the sources
	@$(VENV)/bin/ruff check --fix --quiet python addon tests examples tools cpp
	@$(VENV)/bin/ruff format python addon tests examples tools cpp
	@$(VENV)/bin/clang-format -i $(CPP_FILES)

sanitize: $(VENV)/.tools ## The C++ tests under the address and undefined behaviour sanitizers
	@$(CMAKE) -S . -B build/sanitize -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(VENV)/bin/ninja -DPython_EXECUTABLE=$(CURDIR)/$(PY) \
	  -DCMAKE_BUILD_TYPE=RelWithDebInfo -DFOLLOWTHROUGH_PYTHON=OFF -DFOLLOWTHROUGH_TESTS=ON -DFOLLOWTHROUGH_VALIDATE=ON \
	  -DFOLLOWTHROUGH_SANITIZE=address,undefined > /dev/null
	@$(CMAKE) --build build/sanitize
	@UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1 $(VENV)/bin/ctest --test-dir build/sanitize --output-on-failure

extension: $(VENV)/.tools ## Build and validate the Blender extension's zip in dist/
	@$(PY) tools/build_extension.py

wheel: $(VENV)/.tools ## Build this Python's wheel in dist/
	@wheel=$$($(PY) tools/built_wheel.py) && mkdir -p dist && cp "$$wheel" dist/

clean: ## Remove everything that was built
	rm -rf build dist $(VENV) $(TRAINING_VENV) .venv-bpy* $(DEMO_OUTPUT) $(TRAINING_DATA) python/followthrough/*.so
