"""Runs of the plan in the window: abort, resume, faults, and a window that is killed."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from emulated.x_server import XServer
from window import Display, Window, die_with_parent, strike

import labrig
from labrig.session import Session

KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, {folder!r})
from window import Window

{before}
class Named:
    name = {display!r}

window = Window(Named(), Path({out!r}), rig=Path("{rig}"), scene=Path("{scene}"),
                plan=Path("{plan}"), helper=False)
window.connected()
window.key("F5")
run = window.app.devices
window.pump(lambda: run.run and run.run.saved >= 4)
print(run.run.saved, flush=True)
window.pump()
"""

LIT = """
import numpy as np, time
from drivers.projector.second_screen import ScreenProjector, ScreenSettings
from drivers.waiting import CancelToken

screen = ScreenProjector(
    ScreenSettings(output="PROJ", rows=48, cols=64, display={display!r}, refresh_hz=60.0)
)
screen.open()
(white,) = screen.load([np.full((48, 64), 255, np.uint8)])
screen.show(white, deadline_s=time.monotonic() + 60.0, cancel=CancelToken())
"""


def session_of(window: Window) -> Path:
    """The folder of the newest session."""
    return next(window.app.places.out.glob(f"*/{window.app.day.session}"))


def test_abort_ends_within_a_shot_and_what_was_saved_resumes(window: Window):
    """A5: the partial session opens, is marked so, and Ctrl+R takes what it lacks."""
    app, devices = window.app, window.app.devices
    window.key("F5")
    assert window.pump(lambda: devices.run and devices.run.saved >= 3), window.log
    before = devices.run.saved
    window.key("Escape")
    assert window.pump(lambda: not devices.running)
    assert window.said("run aborted")
    path = session_of(window)
    session = Session.open(path)
    assert session.missing
    assert len(session.frames) <= before + 1  # the shot that was under way, at most
    for shot in session.frames:
        session.read(shot)
    assert app.rail.states[3] != "done"
    window.app.outcomes._begun_s = 0.0  # let the helper look for sessions
    chosen = window.pump(lambda: app.browser.selected and app.browser.selected.path == path)
    assert chosen, window.log
    assert "partial" in app.browser.tree.set(str(path), "state")
    window.key("Control-r")
    assert devices.running
    assert window.pump(lambda: not devices.running), window.log
    assert Session.open(path).missing == ()
    app.outcomes.abort()  # of the analysis that begins by itself


def test_a_run_shows_its_groups_pauses_and_goes_on(window: Window):
    """A cell for every shot, its attempts; what is projected beside what is seen; buttons."""
    app, devices = window.app, window.app.devices
    strike(window, "corrupt", shot="stripes-e0-r0-p02")
    window.key("F5")
    panel = app.live.drawer.run
    assert app.live.drawer.open == "run"
    assert app.live.drawer.winfo_ismapped() or window.pump(app.live.drawer.winfo_ismapped)
    assert window.pump(lambda: "stripes-e0-r0-p02" in panel.saved), window.log
    assert panel.attempts["stripes-e0-r0-p02"] == 2
    panel.buttons["pause"].invoke()
    assert window.pump(lambda: devices.run.state == "paused"), window.log
    saved = devices.run.saved
    assert "disabled" not in panel.buttons["resume"].state()
    assert saved < devices.run.total
    panel.buttons["resume"].invoke()
    assert window.pump(lambda: not devices.running), window.log
    assert app.day.session_whole
    shots = [shot for _, ids in devices.plan.groups for shot in ids]
    assert panel.saved == set(shots)
    assert app.live.drawer.open == ""
    app.outcomes.abort()


def test_a_full_disk_pauses_the_run_and_going_on_completes_it(window: Window):
    """A6: what was saved is safe, and the banner says how many."""
    app, devices = window.app, window.app.devices
    strike(window, "disk-full", shot="stripes-e0-r0-p03")
    window.key("F5")
    assert window.pump(lambda: "disk" in app.banner.text.lower()), window.log
    assert "safe" in app.banner.text
    assert devices.running
    go_on = app.banner.actions.winfo_children()[0]
    assert go_on.cget("text") == "Go on"
    go_on.invoke()
    assert window.pump(lambda: not devices.running), window.log
    assert app.day.session_whole, window.log
    assert Session.open(session_of(window)).missing == ()
    app.outcomes.abort()


def killed_when_it_saved(folder: Path, before: str, screen: str, files: dict[str, Path]) -> int:
    """Run the window in a process of its own, kill it in the middle of a run.

    Returns how many frames it had told were saved.
    """
    script = folder / "run.py"
    text = KILLED.format(
        folder=str(Path(__file__).parent), display=screen, out=str(folder), before=before, **files
    )
    script.write_text(text, encoding="utf-8")
    child = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=die_with_parent,  # noqa: PLW1509
    )
    try:
        saved = int(child.stdout.readline())
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
    return saved


def test_a_killed_window_loses_no_frame_and_leaves_the_projector_black(
    displays: Callable[[int, int], Display],
    tmp_path: Path,
    real_time: Path,
    small_scene: Path,
    small_plan: Path,
):
    """SIGKILL in the middle of a run, in a process that also lights a projector's screen.

    Every frame that was told saved is there, the session resumes, and the screen goes black.
    """
    bench = XServer(tmp_path, right=(64, 48))
    files = {"rig": real_time, "scene": small_scene, "plan": small_plan}
    try:
        saved = killed_when_it_saved(
            tmp_path, LIT.format(display=bench.display), displays(1440, 900).name, files
        )
        assert bench.await_black()
    finally:
        bench.stop()
    (path,) = (tmp_path / "sessions").glob("*/*")
    session = Session.open(path)
    assert len(session.frames) >= saved >= 4
    for shot in session.frames:
        session.read(shot)
    labrig.resume(path)
    assert Session.open(path).missing == ()
