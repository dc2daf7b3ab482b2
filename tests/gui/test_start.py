"""How the window begins: what it remembers, what it loads, and what it must not touch."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from window import LONG_S, ROOT, Display, die_with_parent

from labrig.gui import settings as kept
from labrig.gui.helper import Helper
from labrig.gui.settings import Settings

YESTERDAY = """
import sys
from pathlib import Path
sys.path.insert(0, {folder!r})
from window import Window

class Named:
    name = {display!r}

window = Window(Named(), Path({out!r}), rig=Path({rig!r}), scene=Path({scene!r}),
                plan=Path({plan!r}), scale=1.0, size=(1200, 800), theme="light", helper=False)
window.connected()
app = window.app
app.devices.expose(0.07, 0.0)
app.devices.change_plan(bracket_s=(0.06, 0.3))
assert window.pump(lambda: app.devices.plan.bracket_s == (0.06, 0.3))
assert window.pump(lambda: app.devices.applied.exposure_s == 0.07)
app.show_tab(2)
window.key("F8")
window.close()
"""


def test_settings_come_back_and_a_broken_file_is_no_disaster(tmp_path: Path):
    file = tmp_path / "window.json"
    wanted = Settings(theme="light", tab="field", width=1234, bracket_s=(0.1, 0.4), exposure_s=0.02)
    assert kept.save(file, wanted) == ""
    assert kept.load(file) == (wanted, "")
    file.write_text('{"theme": "puce", "tab": "live", "width": "wide"}', encoding="utf-8")
    found, said = kept.load(file)
    assert found == Settings(tab="live")
    assert "theme" in said
    assert "width" in said
    for broken in ("{", "[]", "\x00\xff"):
        file.write_text(broken, encoding="utf-8")
        found, said = kept.load(file)
        assert found == Settings()
        assert "default" in said
    assert kept.save(Path("/proc/nowhere/window.json"), wanted) != ""


def test_another_start_finds_the_window_as_it_was_left(
    open_window,
    displays: Callable[[int, int], Display],
    tmp_path: Path,
    small_rig,
    small_scene,
    small_plan,
):
    """A9: two processes, one after the other; exposure and bracket are read back."""
    script = tmp_path / "yesterday.py"
    text = YESTERDAY.format(
        folder=str(Path(__file__).parent),
        display=displays(1440, 900).name,
        out=str(tmp_path),
        rig=str(small_rig),
        scene=str(small_scene),
        plan=str(small_plan),
    )
    script.write_text(text, encoding="utf-8")
    subprocess.run([sys.executable, str(script)], check=True, preexec_fn=die_with_parent)
    again = open_window(settings_alone=True)
    app = again.app
    assert app.style.palette.name == "light"
    assert app.tab == 2
    assert not app.log.winfo_ismapped()
    assert (again.root.winfo_width(), again.root.winfo_height()) == (1200, 800)
    assert again.pump(lambda: app.devices.plan.bracket_s == (0.06, 0.3))
    assert again.pump(lambda: app.devices.applied.exposure_s == 0.07)


def test_without_a_display_one_line_says_so(tmp_path: Path):
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    environment["LABRIG_SETTINGS"] = str(tmp_path / "window.json")
    main = [sys.executable, "-c", "from labrig.cli import main; main()", "gui"]
    said = subprocess.run(main, capture_output=True, text=True, env=environment, check=False)
    assert said.returncode == 2
    assert said.stderr.startswith("labrig: no window can be opened")
    assert said.stderr.count("\n") == 1
    missing = subprocess.run(
        [*main, "--rig", "nowhere.yaml"],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert missing.returncode == 2
    assert "nowhere.yaml" in missing.stderr


def test_the_window_shows_before_the_solvers_load():
    """A3, and that the window imports no driver and no science: only what passes the door."""
    code = "import sys, labrig.gui.app, labrig.cli.gui, labrig.gui.start; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    heavy = {
        "numba",
        "matplotlib",
        "scipy",
        "h5py",
        "labrig.station.station",
        "labrig.station.jobs",
    }
    assert heavy.isdisjoint(loaded)
    rooms = [n for n in loaded if n.split(".")[0] in ("drivers", "calibration", "analysis")]
    science = {n for n in rooms if "." in n and not n.endswith(".errors")}
    assert science == {"analysis.reweighting"}  # the factor of Eq. 11 that the slider needs at once


def test_tkinter_has_two_doors():
    """A14: the command line of a machine without tkinter works."""
    found = {
        str(path.relative_to(ROOT))
        for room in ("labrig", "drivers", "calibration", "analysis")
        for path in (ROOT / room).rglob("*.py")
        if "import tkinter" in (text := path.read_text(encoding="utf-8")) or "from tkinter" in text
    }
    outside = {path for path in found if not path.startswith("labrig/gui/")}
    assert outside == {"drivers/projector/screen.py"}


def test_a_helper_that_was_killed_is_replaced():
    """What it was doing is said to be lost; the next thing that is asked is done."""
    helper, said = Helper("killed"), []

    def wait(words: str) -> None:
        end = time.monotonic() + LONG_S
        while not any(words in word for word in said) and time.monotonic() < end:
            helper.poll()
            time.sleep(0.01)
        assert any(words in word for word in said)

    try:
        helper.ask(
            "listed", Path("nowhere"), then=lambda _: said.append("done"), failed=said.append
        )
        os.kill(helper.pid, signal.SIGKILL)
        wait("ended in the middle")
        assert not helper.busy
        helper.ask("listed", Path("nowhere"), then=lambda found: said.append(f"listed {found}"))
        wait("listed []")
        helper.restart()  # as an abort does: the end of the old process is no news
        said.clear()
        helper.ask(
            "listed", Path("nowhere"), then=lambda _: said.append("again"), failed=said.append
        )
        wait("again")
        assert said == ["again"]
    finally:
        helper.stop()


def test_no_kernel_holds_the_interpreter():
    """A14: the window's thread would stand still meanwhile."""
    found = 0
    for path in [*ROOT.glob("analysis/**/*.py"), *ROOT.glob("calibration/*.py")]:
        for line in path.read_text(encoding="utf-8").splitlines():
            if "@njit" in line:
                found += 1
                assert "nogil=True" in line, path
    assert found > 10
