# What a newcomer needs: `make demo` and `make test`. CI calls the same targets.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3 /usr/bin/python3; do \
    command -v $$p >/dev/null 2>&1 && $$p -c 'import sys, tkinter; sys.exit(sys.version_info < (3, 11))' \
    >/dev/null 2>&1 && command -v $$p && break; done)
BIN := .venv/bin
HARDWARE_PACKAGES := xvfb x11-xserver-utils libxrandr2 libxss1 g++ gcc libc6-dev linux-libc-dev \
    libusb-1.0-0 umockdev gir1.2-umockdev-1.0 python3-gi gir1.2-aravis-0.8
VM_PACKAGES := qemu-system-x86 busybox-static cpio kmod udev v4l-utils

.PHONY: demo test test-window hardware-packages vm-packages genicam hardware-vm lint types contracts bench bench-peers bench-gui soak screenshots torture figures lock install clean

demo: install  ## the main job on the simulated rig
	@$(BIN)/labrig demo

test: install  ## everything that is right or wrong
	@$(BIN)/python -m pytest -n auto --dist worksteal --ignore=tests/gui
	@$(MAKE) --no-print-directory test-window

# Apart, for a window draws on every core that there is, and the tests of devices tell milliseconds.
test-window: install  ## of these the operator's window alone, each process with an X server of its own
	@$(BIN)/python -m pytest -n auto --dist worksteal tests/gui

lint: install
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .

types: install
	@$(BIN)/mypy

contracts: install
	@$(BIN)/lint-imports

bench: install  ## everything that is fast or slow
	@$(BIN)/python -m pytest tests/benchmarks --benchmark-enable -q -s

bench-peers: install  ## beside what a user would take instead, each in an environment of its own
	@$(BIN)/python tests/benchmarks/peers.py

bench-gui: install  ## how fast the operator's window is
	@$(BIN)/python tests/gui/bench_window.py

soak: install  ## ten minutes of live view: memory must stay flat
	@$(BIN)/python tests/gui/bench_window.py soak

screenshots: install  ## the pictures of the operator's guide, from the simulated rig
	@$(BIN)/python tests/gui/screenshots.py

torture: install  ## 500 kills at random moments, 10 000 fuzzed files, the power cut at every flush
	@LABRIG_KILLS=500 LABRIG_FUZZ=2500 LABRIG_CUTS=2000 $(BIN)/python -m pytest -q -n auto \
	    tests/labrig/test_resume.py tests/labrig/test_fuzz.py tests/labrig/test_power_cut.py \
	    -k "kills_at_random or one_line or r4"

figures: install  ## the pictures of the README, from a run of the demo and of labrig accuracy
	@rm -rf build/figures && $(BIN)/labrig demo --scene configs/scenes/dilute-milk.yaml \
	    --out build/figures >/dev/null
	@mkdir -p docs/images && cp build/figures/*/*/results/*/figures/attenuation.png \
	    build/figures/*/*/results/*/figures/light-field.png docs/images/
	@$(BIN)/labrig accuracy solver configs/scenes/dilute-milk.yaml --out build/figures/accuracy
	@cp build/figures/accuracy/solver.png docs/images/accuracy-cost.png
	@$(BIN)/labrig accuracy scene configs/scenes/slanted-beam.yaml \
	    --plan configs/plans/six-shifts.yaml --out build/figures/accuracy
	@cp build/figures/accuracy/scene.png docs/images/realism-cost.png
	@$(BIN)/python docs/examples/gallery.py docs/images/gallery.png

hardware-packages:  ## Debian packages that the tests of the drivers need
	@dpkg -s $(HARDWARE_PACKAGES) >/dev/null 2>&1 || apt-get install -qy --no-install-recommends $(HARDWARE_PACKAGES)

vm-packages: hardware-packages  ## and those that the virtual machine needs
	@dpkg -s $(VM_PACKAGES) >/dev/null 2>&1 || apt-get install -qy --no-install-recommends $(VM_PACKAGES)

genicam: install  ## Aravis' Python binding into .venv: Debian's if the Pythons are alike, else built
	@$(BIN)/python -c 'import gi' 2>/dev/null || \
	    { [ -d /usr/lib/python3/dist-packages/gi ] && \
	      [ "$$($(BIN)/python -c 'import sys; print(sys.version_info[:2])')" = \
	        "$$(/usr/bin/python3 -c 'import sys; print(sys.version_info[:2])')" ] && \
	      ln -sfn /usr/lib/python3/dist-packages/gi \
	        "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/gi"; } || \
	    { echo "labrig: building PyGObject (a minute); it needs gcc, pkg-config, libcairo2-dev and libgirepository1.0-dev"; \
	      $(BIN)/python -m pip install --quiet --disable-pip-version-check 'PyGObject<3.52'; }

hardware-vm: install  ## drivers against real kernel drivers, in a virtual machine (minutes)
	@$(BIN)/python tests/hardware/vm/run.py

install: .venv/installed

.venv/installed: requirements.lock pyproject.toml
	@if [ -z "$(PYTHON)" ]; then \
	    echo "labrig needs Python 3.11 or newer with tkinter, venv and pip; none was found."; \
	    echo "On Debian: sudo apt-get install python3 python3-tk python3-venv"; exit 1; fi
	@if [ ! -x $(BIN)/python ]; then echo "labrig: making .venv with $(PYTHON)"; \
	    $(PYTHON) -m venv .venv || { rm -rf .venv; echo "labrig: no virtual environment could be made; on Debian: sudo apt-get install python3-venv"; exit 1; }; fi
	@echo "labrig: installing from requirements.lock (a minute or two, once)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

lock:  ## pin the newest versions that pyproject.toml allows (needs uv)
	uv pip compile --universal --python-version 3.11 --extra dev --generate-hashes \
	    --no-emit-index-url --no-annotate --custom-compile-command "make lock" \
	    --upgrade pyproject.toml -o requirements.lock

clean:  ## what was made here, except sessions
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache *.egg-info .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
