"""Runs only inside the virtual machine that tests/hardware/vm/run.py boots."""

import os
import subprocess

import pytest

KERNEL = os.environ.get("LABRIG_VM_KERNEL", "")
collect_ignore_glob = [] if KERNEL else ["test_*.py"]


@pytest.fixture(scope="session")
def load():
    """Return ``load(module, *parameters)``: load a module of the kernel."""

    def modprobe(*words):
        subprocess.run(["modprobe", "-d", KERNEL, *words], check=True)
        subprocess.run(["udevadm", "settle", "-t", "20"], check=False)

    return modprobe
