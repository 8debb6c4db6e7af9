# Everything sets itself up: `make lab` and `make test` work in a fresh clone.
# Needs make, python3 (3.11 or newer) and python3-venv; works as root and as an ordinary user.

VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
SCENARIO ?=
# Debian packages that some tests compare with; the product itself needs none of them.
TOOLS  := tcpdump tshark iproute2 iputils-ping chromium babeld
# To build the kernel in a box, once.
VM_TOOLS := gcc make flex bison bc libelf-dev xz-utils
PYTEST_ARGS ?=

.PHONY: lab test test-vm test-tunnels agreement vm-tools check bench venv tools clean help

help:
	@echo "make lab     the interactive lab; SCENARIO=FILE, or choose from a list"
	@echo "make test    run the whole test suite"
	@echo "make test-vm run the tests of the kernel in a box, and system tests in virtual time inside it"
	@echo "make test-tunnels run the missions of robots in tunnels, in virtual time"
	@echo "make agreement  compare netem, air and the pure medium in virtual time; writes docs/agreement.md"
	@echo "make check   ruff and mypy"
	@echo "make bench   measure everything; BENCHES=... picks some"
	@echo "make venv    set up $(VENV) only"

$(STAMP): pyproject.toml
	@python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed; python3 is $$(python3 -V 2>&1)"; exit 2; }
	@python3 -m venv $(VENV) || { echo "python3 -m venv failed; on Debian or Ubuntu: sudo apt-get install python3-venv"; exit 2; }
	@$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,check]'
	@touch $@

venv: $(STAMP)

lab: $(STAMP)
	@$(BIN)/netlab lab $(SCENARIO)

test: $(STAMP) tools
	@$(BIN)/python -m pytest -n auto --dist worksteal --lab-clock=real --ignore=tests/vm -m "not real_time" $(PYTEST_ARGS)
	@$(BIN)/python -m pytest tests/system -m real_time $(PYTEST_ARGS)

# The kernel that the box needs is built once per machine (about 10 minutes) and then taken from the cache. System tests
# then run in two boxes side by side, in virtual time: over netem, with the kernel's mesh and radios, then over air.
OVER_NETEM := tests/agreement/test_agreement_engines.py $(wildcard tests/system/test_kernel_netem*.py) \
  $(addprefix tests/system/test_,lab_flood_netem.py lab_hwsim.py lab_measured.py lab_mesh.py lab_scenarios.py lab_wnet_hwsim.py \
  netem_capture.py udp_mesh_goals.py)
OVER_AIR := $(addprefix tests/system/test_,air.py inspect_why.py lab_scenarios.py udp_mesh_copies.py)
IN_BOXES := -n 2 --lab-clock=virtual

test-vm: $(STAMP) tools vm-tools
	@$(BIN)/netlab vm build
	@$(BIN)/python -m pytest -n auto tests/vm $(PYTEST_ARGS)
	@$(BIN)/python -m pytest $(IN_BOXES) --lab-engine=netem $(OVER_NETEM) $(PYTEST_ARGS)
	@$(BIN)/python -m pytest $(IN_BOXES) --lab-engine=air $(OVER_AIR) $(PYTEST_ARGS)

# Robots in tunnels, whole teams of them, in virtual time.
MISSIONS := $(wildcard tests/system/test_lab_tunnels*.py) \
  $(addprefix tests/system/test_lab_,reroutes.py rose_mesh.py)

test-tunnels: $(STAMP) tools vm-tools
	@$(BIN)/netlab vm build
	@$(BIN)/python -m pytest $(IN_BOXES) $(MISSIONS) $(PYTEST_ARGS)

# Rewrites docs/agreement.md: netem, air and the pure medium against theory and each other.
agreement: $(STAMP) vm-tools
	@$(BIN)/netlab vm build
	@$(BIN)/netlab vm --clock virtual --timeout 3000 --output docs -- $(CURDIR)/$(BIN)/python tests/agreement/agreement.py docs/agreement.md

check: $(STAMP)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

# All of them take more than an hour; BENCHES=tests/bench/bench_air.py picks some.
BENCHES ?= $(wildcard tests/bench/bench_*.py)
bench: $(STAMP) tools
	@for bench in $(BENCHES); do echo "== $$bench"; $(BIN)/python $$bench || exit 1; done

# Root installs what is missing; an ordinary user is told, and the tests that need it are skipped with that reason.
tools:
	@missing=""; for tool in tcpdump tshark ip ping chromium babeld; do PATH="$$PATH:/usr/sbin:/sbin" command -v $$tool >/dev/null 2>&1 || missing="$$missing $$tool"; done; \
	if [ -n "$$missing" ]; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then \
	    echo "installing Debian packages for the tests: $(TOOLS)"; \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(TOOLS) >/dev/null || exit 2; \
	  else \
	    echo "missing tools:$$missing; the tests that compare with them are skipped. To run them too:"; \
	    echo "  sudo apt-get install $(TOOLS)"; \
	  fi; \
	fi

vm-tools:
	@missing=""; for tool in gcc flex bison bc xz; do command -v $$tool >/dev/null 2>&1 || missing="$$missing $$tool"; done; \
	[ -e /usr/include/libelf.h ] || missing="$$missing libelf.h"; \
	if [ -n "$$missing" ]; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then \
	    echo "installing Debian packages to build the box's kernel: $(VM_TOOLS)"; \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(VM_TOOLS) >/dev/null || exit 2; \
	  else \
	    echo "missing to build the box's kernel:$$missing. To add it: sudo apt-get install $(VM_TOOLS)"; exit 2; \
	  fi; \
	fi

clean:
	rm -rf $(VENV) captures/*.mcap
