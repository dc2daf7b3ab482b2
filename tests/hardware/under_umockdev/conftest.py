"""These tests run in a process of their own, started by tests/hardware/test_under_umockdev.py."""

import os

collect_ignore_glob = [] if "umockdev" in os.environ.get("LD_PRELOAD", "") else ["test_*.py"]
