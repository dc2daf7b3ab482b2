"""Real libusb against emulated USB devices: each file runs under umockdev in its own process.

umockdev has to be preloaded before a process starts.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from emulated.needs import need, need_typelib

FOLDER = Path(__file__).resolve().parent / "under_umockdev"
BEHAVIOUR = FOLDER.parents[1] / "behaviour"
FILES = [
    *sorted(FOLDER.glob("test_*.py")),
    *(BEHAVIOUR / f"test_every_{kind}.py" for kind in ("camera", "trigger")),
]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_test_of_the_file_passes(file, tmp_path):
    need("umockdev-wrapper", "g++", package="umockdev g++")
    need_typelib("UMockdev", "1.0", package="gir1.2-umockdev-1.0 python3-gi")
    need_typelib("Aravis", "0.8", package="gir1.2-aravis-0.8")
    command = [
        sys.executable,
        "-X",
        "faulthandler",
        "-m",
        "pytest",
        str(file),
        "-q",
        "-p",
        "no:cacheprovider",
    ]
    command += [f"--confcutdir={file.parent}"]  # the program itself is not needed inside
    inside = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    done = subprocess.run(
        ["umockdev-wrapper", *command, f"--basetemp={tmp_path / 'inside'}"],
        capture_output=True,
        text=True,
        timeout=300,  # against a hang; 10 to 27 s each at a load of ten
        env=inside,
        cwd=FOLDER.parents[2],
        check=False,
    )
    report = f"{done.stdout}\n{done.stderr}"
    assert done.returncode == 0, report
    assert " passed" in done.stdout, report
    assert "skipped" not in done.stdout, report
