# make demo   builds the programs and runs the factory line on loopback: three processes, until Ctrl-C
# make demo-clock-fault  the same with the edge's clock wrong on purpose: the delays do not move
# make test   everything that must hold; installs what it needs
# make interop  programs of other projects as peers: ROS 1, ROS 2, llama.cpp, MuJoCo, libzmq
# make check  the quick part: formatting, lints, unit and end-to-end tests
# make bench  the measured tables, ratios side by side in one run
# make soak   hundreds of kills, a day's outage, full disks, with release builds; takes its time
# make deb    the Debian package, in target/debian/
# make hooks  checks the subjects of commits in this checkout
# make setup  ONNX Runtime's library, checked by hash, into onnxruntime/

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
CARGO ?= cargo

.PHONY: help hooks demo demo-clock-fault setup build test check format lint linted-tests tests configs units deny browser api package deb interop bench soak clean
help:
	@sed -n 's/^# //p' $(firstword $(MAKEFILE_LIST)) | head -10

demo: setup
	$(CARGO) build --profile demo --locked --package peernetd --bin peernetd
	ln -sf peernetd target/demo/peernet
	deploy/demo.sh target/demo/peernetd

demo-clock-fault: setup
	$(CARGO) build --profile demo --locked --package peernetd --bin peernetd
	mkdir -p data/clock-fault
	cp configs/aggregator.toml configs/cloud.toml configs/edge.toml data/clock-fault/
	printf '\n[clock_fault]\noffset_ms = 1200.0\ndrift_ppm = 25.0\n' >> data/clock-fault/edge.toml
	deploy/demo.sh target/demo/peernetd data/clock-fault data/clock-fault/logs

hooks:
	git config core.hooksPath deploy/hooks

setup:
	@python3 deploy/onnxruntime/fetch.py

build:
	$(CARGO) build --workspace --all-targets --locked

# --- tests ---------------------------------------------------------------------------------------------------

test: tools setup format linted-tests configs units deny browser api package
	@echo "make test: all passed"

check: lint tests

.PHONY: tools
tools:
	@deploy/install-tools.sh test

format:
	$(CARGO) fmt --all --check

lint: format
	$(CARGO) clippy --workspace --all-targets --locked -- --deny warnings

# Everything is built once, before anything runs: the end-to-end tests start the programs of the same build.
tests: setup build
	@tests/run.py

# The lints in the time in which the tests wait.
linted-tests: setup build
	@tests/run.py --lint

configs: setup build
	@for file in configs/*.toml; do target/debug/peernetd check "$$file"; done
	@for file in configs/experiments/*.toml; do target/debug/peernet run --check "$$file"; done

units:
	@deploy/systemd/verify.sh

deny:
	$(CARGO) deny --all-features --locked check licenses bans sources

# A headless Chromium opens the running demo.
browser: setup build
	@tests/browser/run.sh target/debug/peernetd

# schemathesis asks the running demo what its OpenAPI document promises.
api: setup build
	@tests/api/run.sh target/debug/peernetd

# Of the programs that were built for the tests: how it installs does not depend on how they are optimised.
package: setup build
	@deploy/debian/build.sh target/debug
	@deploy/debian/test.sh target/debian/peernet_*.deb

.PHONY: deb-tools
deb-tools:
	@deploy/install-tools.sh deb

# With what the default build leaves out because it is heavy.
deb: deb-tools setup
	$(CARGO) build --release --locked --package peernetd --bin peernetd --features ros2
	@deploy/debian/build.sh

# --- foreign peers --------------------------------------------------------------------------------------------

# Each folder has programs of one project as peers of ours.
interop:
	@deploy/install-tools.sh interop
	tests/interop/run.sh
	echo "make interop: all passed"

# --- measurements ---------------------------------------------------------------------------------------------

bench: setup
	@deploy/install-tools.sh bench interop
	$(CARGO) build --release --locked --package peernetd --features ros2
	tests/bench/run.sh

soak: setup
	@deploy/install-tools.sh test
	$(CARGO) build --release --locked --package peernetd
	tests/soak/run.sh

clean:
	$(CARGO) clean
	rm -rf onnxruntime data .venv-tools
