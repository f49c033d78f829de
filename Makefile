# celld: build, try, test. `make demo` and `make test` need nothing but cargo, make and a C compiler on
# Debian 12; they install what is missing first.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c

# Found missing by the build otherwise: clang is run by the OpenCV bindings' generator, the others are the
# OpenCV modules celld calls. Not libapriltag-dev: the crate brings the C sources it was made for.
# python3-venv runs the third-party clients of the tests.
PACKAGES := clang pkg-config python3-venv libopencv-core-dev libopencv-imgproc-dev libopencv-imgcodecs-dev \
            libopencv-calib3d-dev libopencv-videoio-dev

ARGS ?=

# `make figures`: a smoke run of a minute or two. The paper's own sizes: docs/evaluation.md.
FIGURES ?= all
SOLVERS ?= paper
COUNT ?= 3
LIMIT ?= 2

.PHONY: help setup clients demo test bench figures

help:
	@echo "make demo [ARGS='--scene planks']   a whole cell in simulation; report in ./out"
	@echo "make test                           formatting, lints, all tests"
	@echo "make figures                        small versions of the paper's six figures in ./out/figures"
	@echo "make bench                          nanoseconds of the collision kernel by pair of shapes"
	@echo "make setup                          install what the build needs (Debian 12), nothing else"

setup:
	@command -v dpkg-query >/dev/null || { \
	  echo "setup: no dpkg here; the build needs the equivalents of: $(PACKAGES)"; exit 0; }; \
	missing=(); \
	for package in $(PACKAGES); do \
	  [ "$$(dpkg-query -W -f='$${db:Status-Status}' "$$package" 2>/dev/null | head -c 9)" = installed ] \
	    || missing+=("$$package"); \
	done; \
	[ $${#missing[@]} -gt 0 ] || exit 0; \
	as_root=(); \
	if [ "$$(id -u)" -ne 0 ]; then \
	  command -v sudo >/dev/null || { \
	    echo "setup: neither root nor sudo; ask for: apt-get install $${missing[*]}" >&2; exit 1; }; \
	  as_root=(sudo); \
	fi; \
	echo "setup: installing $${missing[*]}"; \
	"$${as_root[@]}" apt-get update -qq; \
	"$${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
	  apt-get install -y -qq --no-install-recommends "$${missing[@]}"

# The third-party clients that the simulator is tested with, in an environment of their own.
CLIENTS := $(abspath $(or $(CARGO_TARGET_DIR),target))/clients

clients: setup
	@if ! cmp -s tests/clients/requirements.txt $(CLIENTS)/installed.txt; then \
	  echo "clients: installing $$(grep -v '^#' tests/clients/requirements.txt | tr '\n' ' ')"; \
	  rm -rf $(CLIENTS); python3 -m venv $(CLIENTS); \
	  $(CLIENTS)/bin/pip install --quiet --disable-pip-version-check --no-deps -r tests/clients/requirements.txt; \
	  cp tests/clients/requirements.txt $(CLIENTS)/installed.txt; \
	fi

demo: setup
	cargo run --release --quiet -- demo $(ARGS)

# Tests that read public data pass without looking at anything where there is none: that has to be seen.
DATA := $(or $(CELLD_DATA),../shared/data)

# Without nextest the closed-loop tests (cell_*) run after the others, one at a time: they need the cores.
test: export CELLD_CLIENTS := $(CLIENTS)
test: setup clients
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings
	@[ -d "$(DATA)" ] || echo "SKIPPED: tests on the public instances and camera recordings, no folder $(DATA) (set CELLD_DATA)"
	@if cargo nextest --version >/dev/null 2>&1; then \
	  echo "cargo nextest run"; cargo nextest run; \
	else \
	  echo "cargo test"; cargo test -- --skip cell_; cargo test --test it cell_ -- --test-threads=1; \
	fi

bench: setup
	cargo bench

# Stopped half way, it goes on where it was; delete the table for a fresh start.
figures: setup
	cargo run --release --quiet -- bench planning --figure $(FIGURES) --solver $(SOLVERS) --first \
	  --count $(COUNT) --time-limit $(LIMIT) --out out/figures/limit-$(LIMIT)s.csv
	cargo run --release --quiet -- bench figures out/figures/limit-$(LIMIT)s.csv --out out/figures
