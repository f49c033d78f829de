# celld: build, try, test. `make demo` and `make test` need nothing but cargo, make and a C compiler on
# Debian 12; they install what is missing first.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c

# Found missing by the build otherwise: clang is run by the OpenCV bindings' generator, the others are the
# OpenCV modules celld calls. Not libapriltag-dev: the crate brings the C sources it was made for.
# Debian's calib3d headers depend on those of every other module down to Qt and GDAL: fewer names here would
# install no fewer packages.
PACKAGES := clang pkg-config libopencv-calib3d-dev libopencv-videoio-dev

# `make demo FEATURES=--no-default-features`: without USB cameras, video files and PNG figures.
FEATURES ?=

# python3-venv runs the third-party clients of the tests; their RealSense SDK needs libusb and the
# interpreter as a library.
CLIENT_PACKAGES := python3-venv libpython3.11 libusb-1.0-0

BUILD := $(abspath $(or $(CARGO_TARGET_DIR),target))

ARGS ?=

# `make figures`: a smoke run of a minute or two. The paper's own sizes: docs/evaluation.md.
FIGURES ?= all
SOLVERS ?= paper
COUNT ?= 3
LIMIT ?= 2

# `make fuzz`: seconds for each protocol. Coverage comes from options of the stable compiler; naming the
# target keeps them away from build scripts.
SECONDS ?= 600
FUZZ_TARGETS ?= rtde dashboard primary urscript modbus robotiq tool_serial interpreter robot_api
FUZZ_FLAGS := -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
              -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
              -Cllvm-args=-sanitizer-coverage-trace-compares --cfg fuzzing

# `make install`, `make deb`. PREFIX other than /usr: /usr/local; systemd and udev read both. BINARIES: where
# built ones are; named on the command line, nothing is built.
DESTDIR ?=
PREFIX ?= /usr
BINARIES ?= $(BUILD)/release
VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
DEB_PACKAGES := dpkg-dev binutils

# `make wheel`, `make image`: in $(BUILD)/packages. Both are the same bytes again of the same commit.
PACKAGES_BUILT := $(BUILD)/packages
MOST_MEGABYTES := 15

.PHONY: help setup clients demo try test test-cases test-clients test-clients-many test-page bench-page book bench figures
.PHONY: fuzz fuzz-corpus bench-recording demo-fleet bench-fleet bench-fleet-hour setup-fleet test-fleet test-cluster bench-cluster check-slurm tidy
.PHONY: bench-busy bench-stops soak data release install uninstall deb test-deb sim-static wheel image test-wheel test-image

help:
	@echo "make demo [ARGS='--scene planks']   a whole cell in simulation; report in ./out"
	@echo "make try                            a simulated cell to watch and operate in the browser"
	@echo "make demo-fleet                     four simulated cells, one queue, a page of all of them (installs a NATS server)"
	@echo "make test                           formatting, lints, documentation, all tests but those of the next line"
	@echo "make test-cases                     every fault in every phase, every order in every state (make test: a part)"
	@echo "make tidy                           formatting and house rules alone, in seconds"
	@echo "make test-page                      the page in a browser (installs Chromium)"
	@echo "make bench-recording                what recording costs the daemon"
	@echo "make bench-page                     what viewers of the page cost the loop and the processor (ten minutes)"
	@echo "make bench-stops                    how soon a stop is on the wire beside 200 clients, 1000 files, 100 viewers"
	@echo "make soak [HOURS=8]                 hours of cell time with faults and restarts: does anything grow? out/soak"
	@echo "make bench-busy                     a simulated cell beside 24 tasks that want the processor (installs stress-ng)"
	@echo "make test-fleet                     many cells against a real NATS server (installs it)"
	@echo "make bench-fleet                    100 cells and a NATS server, all killed at random: is each job done once?"
	@echo "make bench-fleet-hour [MINUTES=60]  a cell that is cut off from its fleet for an hour"
	@echo "make test-cluster                   benchmarks over HyperQueue's workers on this computer (installs it)"
	@echo "make bench-cluster                  how much quicker two of its workers are than one"
	@echo "make check-slurm                    the same over Slurm, one node, set up for it (root; installs it)"
	@echo "make test-clients                   other people's clients against the simulator (installs them), and test-wheel"
	@echo "make test-clients-many [RUNS=1000]  those scripts again and again, PARALLEL=20 at a time"
	@echo "make sim-static                     the simulator alone, one file that runs on any Linux"
	@echo "make wheel, make test-wheel         the same in a Python package with a pytest fixture"
	@echo "make image, make test-image         the same as an OCI image, without a container engine"
	@echo "make book                           the pages of docs/ as a book, in ./out/book"
	@echo "make figures                        small versions of the paper's six figures in ./out/figures"
	@echo "make fuzz [SECONDS=600]              fuzz each protocol for so long (fuzz/README.md)"
	@echo "make bench                          nanoseconds of the collision kernel by pair of shapes"
	@echo "make release, make install          the binaries; celld as a service of this computer (docs/operation.md)"
	@echo "make deb                            the same as a Debian package in $(BUILD)"
	@echo "make test-deb                       install, update and remove that package in a copy of this system (root)"
	@echo "make setup                          install what the build needs (Debian 12), nothing else"

# Installs those of $(1) that are missing; what apt says goes to a log.
define install
command -v dpkg-query >/dev/null || { \
  echo "setup: no dpkg here; the build needs the equivalents of: $(1)"; exit 0; }; \
missing=(); \
for package in $(1); do \
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
mkdir -p $(BUILD); log=$(BUILD)/setup.log; \
echo "setup: installing $${missing[*]} and what they need (a minute or two; log: $$log)"; \
{ "$${as_root[@]}" apt-get update -qq && "$${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -qq --no-install-recommends "$${missing[@]}"; } >"$$log" 2>&1 \
  || { tail -n 20 "$$log" >&2; echo "setup: apt-get failed, see $$log" >&2; exit 1; }
endef

setup:
	@$(call install,$(PACKAGES))

# The third-party clients that the simulator is tested with, in an environment of their own.
CLIENTS := $(BUILD)/clients

clients: setup
	@$(call install,$(CLIENT_PACKAGES))
	@if ! cmp -s tests/clients/requirements.txt $(CLIENTS)/installed.txt; then \
	  echo "clients: installing $$(grep -v '^#' tests/clients/requirements.txt | tr '\n' ' ')"; \
	  rm -rf $(CLIENTS); python3 -m venv $(CLIENTS); \
	  $(CLIENTS)/bin/pip install --quiet --disable-pip-version-check --no-deps -r tests/clients/requirements.txt; \
	  cp tests/clients/requirements.txt $(CLIENTS)/installed.txt; \
	fi

# The first build takes most of the time; cargo shows how far it is.
demo: setup
	@echo "demo: building celld (about ten minutes the first time on two cores, seconds afterwards)"
	@cargo build --release --bin celld $(FEATURES)
	@echo "demo: the cell in simulation (about a minute)"
	@cargo run --release --quiet $(FEATURES) -- demo $(ARGS)

# A whole simulated cell to try out: simulator and daemon until Ctrl-C, and a link to the cell's page.
TRY := out/try
try: setup
	@cargo build --release
	@mkdir -p $(TRY); trap 'kill %1 %2 2>/dev/null; wait' EXIT INT TERM; \
	$(BUILD)/release/celld sim --config config/sim.yaml >$(TRY)/sim.log 2>&1 & \
	$(BUILD)/release/celld run --config config/cell.yaml --state $(TRY)/state >$(TRY)/celld.log 2>&1 & \
	echo "try: a simulated cell starts; its log is $(TRY)/celld.log, Ctrl-C ends it"; \
	until $(BUILD)/release/celld open --state $(TRY)/state 2>/dev/null; do \
	  kill -0 %1 %2 2>/dev/null || { tail -n 3 $(TRY)/sim.log $(TRY)/celld.log >&2; exit 1; }; sleep 0.5; \
	done; \
	echo "try: open this link within two minutes; for another one: $(BUILD)/release/celld open --state $(TRY)/state"; wait || true

# Tests that read public data pass without looking at anything where there is none: that has to be seen.
DATA := $(or $(CELLD_DATA),../shared/data)

data:
	@echo $(abspath $(DATA))

# First what needs no time of its own, then the whole cells over sockets (cell_*, robot_session), four at a
# time: most of their time is real time that passes. The rest follows. Nothing runs beside the cells: a test
# of the lowest priority that held the file system's journal and waited for the processor kept a cell from
# writing for 15 s. Without nextest all run one after the other.
#
# All targets name the whole workspace and the one feature that is not there by default: with fewer crates or
# features everything is built once more. What a build without the feature says, clippy reads below.
TESTED := --workspace --features fleet
CELLS := test(/(^|::)cell_/) | test(/^robot_session::/)
# The cell in virtual time, and all units but those of the simulator's servers: a long wait for the processor
# changes nothing.
TIMELESS := (test(/^(closed_loop|first_moves|gripper_box|looks|mutants|replay|sights|ways_back)::/) | kind(lib) - package(ur-sim)) \
            - ($(CELLS))
# Those of `make test-clients` and those with the server of `make test-fleet`.
ELSEWHERE := test(/^third_party::/) | package(cell-fleet) & kind(test)

# Which part of the faults and of the orders in all states is tried: any other one with another commit,
# without git with another day.
export CELLD_PART ?= $(shell printf '%d' 0x$$(git -C $(CURDIR) rev-parse HEAD 2>/dev/null | head -c 6) 2>/dev/null \
                       | grep -x '[1-9][0-9]*' || date +%s | cut -c 1-5)

# What needs no build of the workspace: a breach of a house rule is found in seconds.
tidy:
	cargo fmt --all --check
	@mkdir -p $(BUILD); CARGO_MANIFEST_DIR=$(CURDIR) rustc --edition 2024 --test tests/tidy.rs -o $(BUILD)/tidy
	@CARGO_MANIFEST_DIR=$(CURDIR) $(BUILD)/tidy --quiet

test: setup tidy
	cargo clippy $(TESTED) --all-targets -- -D warnings
	cargo clippy --workspace --no-default-features --lib --bins --test tidy -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --quiet $(TESTED) --no-deps --lib
	cargo test --quiet --doc $(TESTED)
	@[ -d "$(DATA)" ] || echo "SKIPPED: tests on the public instances and camera recordings, no folder $(DATA) (set CELLD_DATA)"
	@if cargo nextest --version >/dev/null 2>&1; then \
	  cargo nextest run $(TESTED) --no-run; \
	  sync; \
	  echo "cargo nextest run"; \
	  failed=0; \
	  cargo nextest run $(TESTED) -E '$(TIMELESS) - ($(ELSEWHERE))' || failed=1; \
	  cargo nextest run $(TESTED) --profile cells --test-threads 4 -E '$(CELLS)' || failed=1; \
	  cargo nextest run $(TESTED) -E 'not ($(ELSEWHERE) | $(CELLS) | $(TIMELESS))' || failed=1; \
	  [ $$failed = 0 ]; \
	else \
	  echo "cargo test"; \
	  cargo build $(TESTED) --bins; \
	  cargo test $(TESTED) --lib --bins --examples -- --skip realsense::tests::; \
	  cargo test $(TESTED) --test it --test tidy -- --skip ::cell_ --skip robot_session:: --skip third_party::; \
	  cargo test $(TESTED) --lib -- realsense::tests:: --test-threads=1; \
	  cargo test $(TESTED) --test it -- ::cell_ robot_session:: --test-threads=1; \
	fi

# Every fault in every phase and every order in every state, of which `make test` tries a part.
test-cases: setup
	CELLD_ALL_CASES=1 cargo test $(TESTED) --test it -- every_fault_has every_order_in no_rule_is_broken

# The simulator alone, to be copied anywhere: no library, stripped, at most MOST_MEGABYTES. Naming the target
# keeps the link flags away from build scripts. Needs no OpenCV, so no `setup`.
HOST = $(shell rustc -vV | sed -n 's/^host: //p')
STATIC = $(BUILD)/$(HOST)/dist/celld-sim
sim-static:
	RUSTFLAGS="$(RUSTFLAGS) -C target-feature=+crt-static" cargo build --profile dist -p ur-sim --bin celld-sim --target $(HOST)
	@packages/static.sh $(STATIC) $(MOST_MEGABYTES)

# hatchling, a build backend of Python's packaging authority, puts the package together: it knows the format,
# and gives the same bytes again. From a copy, so that nothing is left in the sources and the licences are
# there. pytest tests it where it is installed, in an environment with nothing else of celld.
PYTHON_ENV := $(BUILD)/python
WHEEL := $(PACKAGES_BUILT)/celld_sim-$(VERSION)-*.whl

$(PYTHON_ENV)/installed.txt: packages/python/requirements.txt
	@$(call install,python3-venv)
	@echo "wheel: installing $$(grep -v '^#' $< | tr '\n' ' ')"
	@rm -rf $(PYTHON_ENV); python3 -m venv $(PYTHON_ENV)
	@$(PYTHON_ENV)/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<
	@cp $< $@

# What is made is dated at the commit.
DATED := $$(git -C $(CURDIR) log -1 --format=%ct 2>/dev/null || echo 0)

wheel: sim-static $(PYTHON_ENV)/installed.txt
	@rm -rf $(PACKAGES_BUILT)/python $(PACKAGES_BUILT)/celld_sim-*.whl; mkdir -p $(PACKAGES_BUILT)
	@cp -r packages/python $(PACKAGES_BUILT)/python; cp LICENSE-APACHE LICENSE-MIT $(PACKAGES_BUILT)/python
	@export CELLD_SIM_BINARY=$(STATIC) CELLD_SIM_VERSION=$(VERSION) SOURCE_DATE_EPOCH=$(DATED); \
	$(PYTHON_ENV)/bin/pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --no-cache-dir \
	  --wheel-dir $(PACKAGES_BUILT) $(PACKAGES_BUILT)/python
	@echo "wheel: $$(ls $(WHEEL))"

test-wheel: wheel
	@$(PYTHON_ENV)/bin/pip install --quiet --disable-pip-version-check --no-deps --no-index --force-reinstall $(WHEEL)
	@cd tests/wheel && $(PYTHON_ENV)/bin/python -B -m pytest -q -p no:cacheprovider --durations=5

image: sim-static
	@$(call install,python3)
	@python3 -B packages/image/write.py $(STATIC) $(VERSION) $(DATED) $(PACKAGES_BUILT)/image
	@echo "image: oci:$(PACKAGES_BUILT)/image:$(VERSION)"

test-image: image $(PYTHON_ENV)/installed.txt
	@$(call install,skopeo)
	@cd tests/image && CELLD_IMAGE=$(PACKAGES_BUILT)/image CELLD_STATIC=$(STATIC) CELLD_VERSION=$(VERSION) \
	  $(PYTHON_ENV)/bin/python -B -m pytest -q -p no:cacheprovider

# Also the calls of the RealSense SDK, which comes with the clients.
test-clients: export CELLD_CLIENTS := $(CLIENTS)
test-clients: clients test-wheel
	@if cargo nextest --version >/dev/null 2>&1; then \
	  cargo nextest run $(TESTED) -E 'test(/^third_party::/) | test(/realsense::tests::/)'; \
	else \
	  cargo test --test it -- third_party::; cargo test --lib -- realsense::tests:: --test-threads=1; \
	fi

# The same scripts RUNS times, PARALLEL at a time, against simulators of the release build.
RUNS ?= 1000
PARALLEL ?= 20

test-clients-many: clients
	@cargo build --release --quiet -p ur-sim --bin celld-sim
	@$(CLIENTS)/bin/python -B tests/clients/many.py --runs $(RUNS) --parallel $(PARALLEL) --out $(BUILD)/client-runs \
	  -- $(BUILD)/release/celld-sim

# The page in a real browser: installs Chromium and what drives it, into an environment of its own.
PAGE := $(BUILD)/page
PAGE_PACKAGES := chromium fonts-dejavu-core python3-venv

$(PAGE)/installed.txt: tests/page/requirements.txt
	@$(call install,$(PAGE_PACKAGES))
	@echo "test-page: installing $$(grep -v '^#' $< | tr '\n' ' ')"
	@rm -rf $(PAGE); python3 -m venv $(PAGE)
	@$(PAGE)/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<
	@cp $< $@

# Many cells: a NATS server in an environment of its own, and the tests with it.
FLEET := $(BUILD)/fleet

setup-fleet $(FLEET)/installed.txt: tests/fleet/requirements.txt
	@$(call install,python3-venv)
	@if ! cmp -s $< $(FLEET)/installed.txt; then \
	  echo "setup-fleet: installing $$(grep -v '^#' $< | tr '\n' ' ')"; \
	  rm -rf $(FLEET); python3 -m venv $(FLEET); \
	  $(FLEET)/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<; \
	  cp $< $(FLEET)/installed.txt; \
	fi

demo-fleet: setup setup-fleet
	@echo "demo-fleet: building celld with the feature fleet (about ten minutes the first time)"
	@cargo build --release --bin celld --features fleet
	@echo "demo-fleet: the cells in simulation (some minutes)"
	@$(BUILD)/release/celld fleet demo --nats-server $(FLEET)/bin/nats-server $(ARGS)

# Figures, none of them judged but one: no job is lost or done twice. About ten minutes.
bench-fleet: setup-fleet
	cargo bench --features fleet --bench fleet_storm -- --nats $(FLEET)/bin/nats-server $(ARGS)
	cargo build --release --features fleet --bin celld
	$(FLEET)/bin/python -B tests/fleet/loop_cost.py $(BUILD)/release/celld $(FLEET)/bin/nats-server

bench-fleet-hour: setup-fleet
	cargo build --release --features fleet --bin celld
	$(FLEET)/bin/python -B tests/fleet/cut_off.py $(BUILD)/release/celld $(FLEET)/bin/nats-server $(or $(MINUTES),60)

FLEET_TESTS := $(patsubst crates/cell-fleet/tests/%.rs,--test %,$(wildcard crates/cell-fleet/tests/*.rs))

test-fleet: export CELLD_NATS_SERVER := $(FLEET)/bin/nats-server
test-fleet: export CELLD_MQTT_PYTHON := $(FLEET)/bin/python
test-fleet: setup setup-fleet $(PAGE)/installed.txt
	@$(call install,$(PAGE_PACKAGES))
	@if cargo nextest --version >/dev/null 2>&1; then \
	  cargo nextest run $(TESTED) --lib $(FLEET_TESTS) -E 'package(cell-fleet) | test(/fleet/)'; \
	else \
	  cargo test -p cell-fleet; cargo test --features fleet --lib -- fleet; \
	fi
	cargo build $(TESTED) --bin celld --test tidy
	python3 -B tests/fleet/demo.py $(BUILD)/debug/celld $(FLEET)/bin/nats-server $(FLEET)/demo $(PAGE)/bin/python

# Benchmarks over many machines: HyperQueue's Python API, which has server and workers inside, in an
# environment of its own.
CLUSTER := $(BUILD)/cluster

$(CLUSTER)/installed.txt: tests/cluster/requirements.txt
	@$(call install,python3-venv)
	@echo "test-cluster: installing $$(grep -v '^#' $< | tr '\n' ' ')"
	@rm -rf $(CLUSTER); python3 -m venv $(CLUSTER)
	@$(CLUSTER)/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<
	@cp $< $@

# Built as for `test-page`, so that nothing is built twice.
test-cluster: setup $(CLUSTER)/installed.txt
	cargo build $(TESTED) --bin celld --test tidy
	@cd tests/cluster && CELLD_BINARY=$(BUILD)/debug/celld \
	  $(CLUSTER)/bin/python -B -m pytest -q -p no:cacheprovider --durations=5

# Figures, none of them judged: the cells of one figure with one worker and with two. A work limit, so that
# both do the same; a minute or two.
SPEEDUP ?= --figure rand-pp --solver auto --count 20 --work 300000 --time-limit 600

bench-cluster: setup $(CLUSTER)/installed.txt
	cargo build --release --bin celld
	$(CLUSTER)/bin/python -B benches/cluster/on_hyperqueue.py --celld $(BUILD)/release/celld --shards 16 \
	  --speedup 1,2 -- $(SPEEDUP)

# Slurm's daemons need root; they are those of Debian, in a folder of their own, and end with the check.
check-slurm: setup $(CLUSTER)/installed.txt
	@$(call install,slurm-wlm munge)
	cargo build $(TESTED) --bin celld --test tidy
	$(CLUSTER)/bin/python -B tests/cluster/slurm_node.py $(BUILD)/debug/celld

# With the features that the libraries have in `make test` too (a test target adds those of the tests), so
# that nothing is built for the page alone.
test-page: setup $(PAGE)/installed.txt
	@$(call install,$(PAGE_PACKAGES))
	cargo build $(TESTED) --bin celld --test tidy
	$(PAGE)/bin/python tests/page/operate.py $(BUILD)/debug/celld $(PAGE)/pictures

# Figures, none of them judged: the loop with 20 viewers and without, in turn; one who watches the film.
bench-page:
	cargo build --release --bin celld
	python3 -B tests/page/viewers.py $(BUILD)/release/celld

# The pages of docs/ as a book. mdBook is built once, without its server. Chapters that lie elsewhere in the
# repository are included by a page of docs/; links to them lead to that page in the book.
MDBOOK_VERSION := 0.5.4
BOOK_TOOLS := $(BUILD)/book-tools
BOOK := out/book
BOOK_LINKS := -e 's|href="\.\./ARCHITECTURE\.html|href="architecture.html|g' \
              -e 's|href="\.\./hardware/README\.html|href="hardware.html|g' \
              -e 's|href="\.\./calibration/README\.html|href="calibration-files.html|g' \
              -e 's|href="\.\./packages/python/README\.html|href="python.html|g' \
              -e 's|href="\.\./docs/|href="|g'

book:
	@if [ "$$($(BOOK_TOOLS)/bin/mdbook --version 2>/dev/null)" != "mdbook v$(MDBOOK_VERSION)" ]; then \
	  mkdir -p $(BUILD); log=$(BUILD)/book-tools.log; \
	  echo "book: building mdBook $(MDBOOK_VERSION), once (some minutes; log: $$log)"; \
	  cargo install mdbook --locked --version $(MDBOOK_VERSION) --no-default-features --features search \
	    --force --quiet --root $(BOOK_TOOLS) >"$$log" 2>&1 \
	    || { tail -n 20 "$$log" >&2; echo "book: mdBook was not built, see $$log" >&2; exit 1; }; \
	fi
	@echo "book: building the chapters"
	@rm -rf $(BOOK); MDBOOK_LOG=warn RUST_LOG=warn $(BOOK_TOOLS)/bin/mdbook build
	@sed -i $(BOOK_LINKS) $(BOOK)/*.html
	@echo "book: following the links"
	@cd $(BOOK); dead=0; \
	while IFS=: read -r page link; do \
	  [ -e "$${link:-.}" ] || { echo "book: $$page leads to $$link, which is not there" >&2; dead=1; }; \
	done < <(grep -oE '(href|src)="[^"#:]+' -- *.html | sed -E 's/(href|src)="//' | sort -u); \
	exit $$dead
	@echo "book: $(BOOK)/index.html"

bench: setup
	cargo bench

# How soon is a stop on the wire while everything else wants celld's attention? Figures; it fails if a stop
# is refused or an order is not answered. With ARGS=--judge it also fails if a time exceeds its limit.
bench-stops: setup
	cargo build --release --quiet --bin celld
	python3 -B tests/load/stop_latency.py --celld $(BUILD)/release/celld $(ARGS)

# Hours of cell time, five times as fast as real time where the computer is quick enough.
HOURS := 8
soak: setup
	cargo build --release --quiet --bin celld
	python3 -B tests/load/soak.py --celld $(BUILD)/release/celld --hours $(HOURS)

# Is a simulated cell stopped because the computer is busy? With a simulator that waits for nobody it has to
# be, or the load was none.
BUSY_PACKAGES := stress-ng
BUSY := python3 -B tests/load/busy_computer.py --celld $(BUILD)/release/celld
bench-busy: setup
	@$(call install,$(BUSY_PACKAGES))
	@cargo build --release --quiet --bin celld
	@$(BUSY)
	@echo "bench-busy: with --strict"; $(BUSY) --strict --arms 5 --demos 0 --expect-stops

# What recording costs the daemon: figures, none of them judged. Two simulated cells at real time, minutes.
bench-recording: setup
	cargo build --release --bin celld
	python3 -B benches/recording_cost.py $(BUILD)/release/celld

# Stopped half way, it goes on where it was; delete the table for a fresh start.
figures: setup
	cargo run --release --quiet -- bench planning --figure $(FIGURES) --solver $(SOLVERS) --first \
	  --count $(COUNT) --time-limit $(LIMIT) --out out/figures/limit-$(LIMIT)s.csv
	cargo run --release --quiet -- bench figures out/figures/limit-$(LIMIT)s.csv --out out/figures

# New inputs are kept in target/fuzz/found, crashes in target/fuzz/crashes; fuzz/README.md says what to do
# with them. `make fuzz-corpus` packs target/fuzz/corpus into the archives that are checked in, byte for byte
# the same for the same files.
fuzz: setup
	host=$$(rustc -vV | sed -n 's/^host: //p'); \
	RUSTFLAGS="$(FUZZ_FLAGS)" cargo build --release --manifest-path fuzz/Cargo.toml --target-dir target/fuzz --target $$host; \
	mkdir -p target/fuzz/crashes; \
	for target in $(FUZZ_TARGETS); do \
	  mkdir -p target/fuzz/found/$$target target/fuzz/corpus/$$target; \
	  tar -xzf fuzz/corpus/$$target.tar.gz -C target/fuzz/corpus/$$target; \
	  target/fuzz/$$host/release/$$target -max_total_time=$(SECONDS) -timeout=20 -rss_limit_mb=2048 -max_len=4352 \
	    -print_final_stats=1 -artifact_prefix=target/fuzz/crashes/$$target- \
	    target/fuzz/found/$$target target/fuzz/corpus/$$target; \
	done

fuzz-corpus:
	@for target in $(FUZZ_TARGETS); do \
	  (cd target/fuzz/corpus/$$target && tar --sort=name --mtime=@0 --owner=0 --group=0 --numeric-owner --mode=644 \
	    -cf - -- *) | gzip -9n > fuzz/corpus/$$target.tar.gz; \
	done

# Unless the binaries come from elsewhere.
release: $(if $(filter file,$(origin BINARIES)),setup)
	@$(if $(filter file,$(origin BINARIES)),rm -f $(BINARIES)/celld-video; cargo build --release $(FEATURES))

# Where each file goes, below $(DESTDIR). What names a path below /usr names one below $(PREFIX) then.
SHARE = $(PREFIX)/share/celld
DOC = $(PREFIX)/share/doc/celld
# celld-video where it was built: not without the feature `video`.
PROGRAMS := celld celld-sim
BUILT = $(PROGRAMS) $(notdir $(wildcard $(BINARIES)/celld-video))
HELPERS := set-up address-filter
EXAMPLES := cell.yaml sim.yaml calibration/sim/camera.yaml calibration/sim/hand_eye.yaml calibration/sim/table.yaml
# Without the pages that are there for the book alone: they include others.
BOOK_ONLY := $(addprefix docs/,SUMMARY.md architecture.md calibration-files.md contributing.md hardware.md python.md)
PAGES = README.md ARCHITECTURE.md LICENSE-APACHE LICENSE-MIT config/README.md calibration/README.md packages/python/README.md \
        $(filter-out $(BOOK_ONLY),$(wildcard docs/*.md)) $(wildcard hardware/*.md hardware/*/*.md)
INSTALLED = $(addprefix $(PREFIX)/bin/,$(PROGRAMS) celld-video) \
            $(addprefix $(PREFIX)/lib/celld/,$(HELPERS)) \
            $(PREFIX)/lib/systemd/system/celld.service \
            $(PREFIX)/lib/sysusers.d/celld.conf $(PREFIX)/lib/tmpfiles.d/celld.conf \
            $(PREFIX)/lib/udev/rules.d/60-celld-camera.rules $(COMPLETIONS)
COMPLETIONS = $(PREFIX)/share/bash-completion/completions/celld $(PREFIX)/share/zsh/site-functions/_celld \
              $(PREFIX)/share/fish/vendor_completions.d/celld.fish
MAN = $(PREFIX)/share/man/man1
UNITS := hardware/systemd

# As it is in the repository, with the paths of this installation: mode, from, to.
define placed
sed -e 's#/usr/\(bin\|lib\|share\)/\(celld\|doc/celld\)#$(PREFIX)/\1/\2#g' $(2) \
  | install -D -m $(1) /dev/stdin $(DESTDIR)$(3)
endef

# The example configuration, from $(1), for the place where it is installed.
define example
sed -e 's#\.\./calibration/#calibration/#g' -e 's#\.\./recordings#/var/lib/celld/recordings#g' \
  -e 's#check config/cell.yaml#check /etc/celld/cell.yaml#' $(1)
endef

# Makes account, folders and the first configuration as well, where it installs into the running system. What
# is in /etc/celld stays as it is; nothing is started. Builds nothing, for root has no cargo: `make release`
# comes first.
install:
	@for binary in $(PROGRAMS); do [ -x $(BINARIES)/$$binary ] \
	  || { echo "install: no $(BINARIES)/$$binary; first: make release" >&2; exit 1; }; done
	$(foreach program,$(BUILT),install -D -m 0755 $(BINARIES)/$(program) $(DESTDIR)$(PREFIX)/bin/$(program);)
	$(foreach helper,$(HELPERS),$(call placed,0755,$(UNITS)/$(helper),$(PREFIX)/lib/celld/$(helper));)
	$(call placed,0644,$(UNITS)/celld.service,$(PREFIX)/lib/systemd/system/celld.service)
	$(call placed,0644,$(UNITS)/celld.sysusers,$(PREFIX)/lib/sysusers.d/celld.conf)
	$(call placed,0644,$(UNITS)/celld.tmpfiles,$(PREFIX)/lib/tmpfiles.d/celld.conf)
	$(call placed,0644,$(UNITS)/60-celld-camera.rules,$(PREFIX)/lib/udev/rules.d/60-celld-camera.rules)
	[ -e $(DESTDIR)/etc/celld/environment ] \
	  || install -D -m 0644 $(UNITS)/environment $(DESTDIR)/etc/celld/environment
	$(BINARIES)/celld completions bash | install -D -m 0644 /dev/stdin $(DESTDIR)$(word 1,$(COMPLETIONS))
	$(BINARIES)/celld completions zsh | install -D -m 0644 /dev/stdin $(DESTDIR)$(word 2,$(COMPLETIONS))
	$(BINARIES)/celld completions fish | install -D -m 0644 /dev/stdin $(DESTDIR)$(word 3,$(COMPLETIONS))
	$(BINARIES)/celld man --out $(DESTDIR)$(MAN)
	$(call example,config/cell.yaml) | install -D -m 0644 /dev/stdin $(DESTDIR)$(SHARE)/examples/cell.yaml
	install -D -m 0644 config/sim.yaml $(DESTDIR)$(SHARE)/examples/sim.yaml
	$(foreach file,$(filter calibration/%,$(EXAMPLES)),install -D -m 0644 $(file) $(DESTDIR)$(SHARE)/examples/$(file);)
	$(foreach page,$(PAGES),install -D -m 0644 $(page) $(DESTDIR)$(DOC)/$(page);)
	@if [ -z "$(DESTDIR)" ] && [ "$$(id -u)" -eq 0 ]; then \
	  $(PREFIX)/lib/celld/set-up; \
	  $(PREFIX)/lib/celld/address-filter write || true; \
	  if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi; \
	  echo "install: how to go on is in $(DOC)/docs/operation.md"; \
	fi

# Configuration and state stay.
uninstall:
	@if [ -z "$(DESTDIR)" ] && [ -d /run/systemd/system ]; then systemctl --quiet disable --now celld || true; fi
	rm -f $(addprefix $(DESTDIR),$(INSTALLED)) $(DESTDIR)$(MAN)/celld.1 $(DESTDIR)$(MAN)/celld-*.1
	rm -rf $(DESTDIR)$(SHARE) $(DESTDIR)$(DOC)
	rmdir --ignore-fail-on-non-empty $(DESTDIR)$(PREFIX)/lib/celld
	@if [ -z "$(DESTDIR)" ] && [ -d /run/systemd/system ]; then systemctl daemon-reload; fi

# No debhelper: there is one binary package of files that `make install` places. The libraries it needs are
# read out of the binaries. Made anew of the same commit and binaries, it is the same file.
STAGE := $(BUILD)/deb
deb: release
	@$(call install,$(DEB_PACKAGES))
	@umask 022; rm -rf $(STAGE); mkdir -p $(STAGE)/root/DEBIAN $(STAGE)/debian
	@$(MAKE) --no-print-directory --silent install DESTDIR=$(STAGE)/root PREFIX=/usr BINARIES=$(BINARIES)
	@umask 022; cd $(STAGE)/root; strip --strip-debug $(addprefix usr/bin/,$(BUILT)); \
	install -m 0644 $(CURDIR)/hardware/debian/copyright usr/share/doc/celld/copyright; \
	find usr etc -type f -print0 | sort -z | xargs -0 md5sum >DEBIAN/md5sums; \
	install -m 0644 $(CURDIR)/hardware/debian/conffiles DEBIAN; \
	install -m 0755 $(addprefix $(CURDIR)/hardware/debian/,postinst prerm postrm) DEBIAN; \
	printf 'Source: celld\n\nPackage: celld\nArchitecture: any\n' >../debian/control; \
	needed=$$(cd .. && dpkg-shlibdeps -O $(addprefix root/usr/bin/,$(BUILT)) 2>shlibdeps.log) \
	  || { cat ../shlibdeps.log >&2; exit 1; }; \
	size=$$(du -sk usr etc | awk '{ sum += $$1 } END { print sum }'); \
	sed -e "s/@VERSION@/$(VERSION)/" -e "s/@ARCHITECTURE@/$$(dpkg --print-architecture)/" -e "s/@SIZE@/$$size/" \
	  -e "s/@DEPENDS@/$${needed#shlibs:Depends=}/" $(CURDIR)/hardware/debian/control.in >DEBIAN/control; \
	export SOURCE_DATE_EPOCH=$$(git -C $(CURDIR) log -1 --format=%ct 2>/dev/null || date +%s); \
	dpkg-deb --root-owner-group --build . $(BUILD)

test-deb: deb
	tests/package.sh $(BUILD)/celld_$(VERSION)_$$(dpkg --print-architecture).deb $(VERSION)
