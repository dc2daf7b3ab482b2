"""A display and a window that the tests of this folder share."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from window import SLANT_DEG, Display, Open, Window

import labrig


@pytest.fixture(scope="session")
def displays() -> Iterator[Callable[[int, int], Display]]:
    """Return ``start(width, height)``: X servers that outlive every window.

    Tcl ends a process whose server is gone.
    """
    running: dict[tuple[int, int], Display] = {}

    def start(width: int, height: int) -> Display:
        if (width, height) not in running:
            running[width, height] = Display(width, height)
        return running[width, height]

    yield start
    for one in running.values():
        one.stop()


@pytest.fixture(scope="session")
def real_time(small_rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small rig at the pace of a real one."""
    path = tmp_path_factory.mktemp("rig") / "real-time.yaml"
    text = small_rig.read_text(encoding="utf-8")
    path.write_text(f"{text}simulation: {{clock: real}}\n", encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def results_root(
    tmp_path_factory: pytest.TempPathFactory, small_rig: Path, small_scene: Path, small_plan: Path
) -> Path:
    """A data root of two analysed sessions: the beam of the second is slanted. To be read only."""
    folder = tmp_path_factory.mktemp("results")
    plan = labrig.load_plan(small_plan)
    text = small_scene.read_text(encoding="utf-8")
    for angle in (0, SLANT_DEG):
        scene = folder / f"beam-{angle}.yaml"
        scene.write_text(
            text.replace("to_mm: 16.8", f"to_mm: 16.8, angle_deg: {angle}"), encoding="utf-8"
        )
        with labrig.open_rig(small_rig, scene, plan) as rig:
            labrig.analyse(labrig.capture(plan, rig, folder / "sessions"))
    return folder / "sessions"


@pytest.fixture
def open_window(
    displays: Callable[[int, int], Display],
    tmp_path: Path,
    small_rig: Path,
    small_scene: Path,
    small_plan: Path,
) -> Iterator[Open]:
    """Return ``open(**options)``: a window on the small rig, connected; all close with the test."""
    opened: list[Window] = []

    def open_(
        size: tuple[int, int] = (1440, 900), *, settings_alone: bool = False, **options: Any
    ) -> Window:
        files = {"rig": small_rig, "scene": small_scene, "plan": small_plan}
        given = {"scale": 1.0, "helper": False, **files, **options}
        if not settings_alone:  # else they are those that were left
            given["size"] = size
        window = Window(displays(*size), tmp_path, **given)
        opened.append(window)
        window.connected()
        return window

    yield open_
    for window in opened:
        if hasattr(window, "app"):
            window.close()


@pytest.fixture(scope="module")
def shared(
    displays: Callable[[int, int], Display],
    tmp_path_factory: pytest.TempPathFactory,
    real_time: Path,
    small_scene: Path,
    small_plan: Path,
) -> Iterator[Window]:
    """A window on the small rig in real time, which the tests of a module share."""
    opened = Window(
        displays(1440, 900),
        tmp_path_factory.mktemp("window"),
        rig=real_time,
        scene=small_scene,
        plan=small_plan,
        scale=1.0,
        size=(1440, 900),
        helper=False,
    )
    opened.connected()
    yield opened
    opened.close()


@pytest.fixture
def window(shared: Window) -> Iterator[Window]:
    """The shared window as it was when it opened: live, with stripes, nothing wrong.

    The tests of a module may run in any order, and any of them alone.
    """
    app = shared.app
    app.show_tab(0)
    app.banner.hide()
    app.devices.open_drawer("")
    app.live.profile.set(False)
    app.live.decomposing.set(False)
    app.devices.show("stripes")
    app.devices.set_roi(None)
    app.live.pane.fit()
    if app.live.paused.get():
        app.devices.hold(paused=False)
    app.devices.expose(0.05, 0.0)
    app.live.pane.focus_force()
    ready = shared.pump(
        lambda: (
            app.live.picture is not None
            and app.live.picture.exposure_s == 0.05
            and app.live.picture.shows == "stripes"
            and not app.banner.text
        )
    )
    assert ready, shared.log
    yield shared
    assert shared.calls_of_other_threads == []


@pytest.fixture(autouse=True)
def _no_collection_elsewhere() -> Iterator[None]:
    """Let no other thread free a closed window: Tcl ends the process that does."""
    gc.disable()
    yield
    gc.collect()
    gc.enable()
