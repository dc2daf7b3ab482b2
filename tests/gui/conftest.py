"""A display and a window that the tests of this folder share."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from window import Display, Window


@pytest.fixture(scope="session")
def display() -> Iterator[Display]:
    """An X server of 1600 x 1000 px."""
    running = Display(1600, 1000)
    yield running
    running.stop()


@pytest.fixture(scope="session")
def screens() -> Iterator[Callable[[int, int], Display]]:
    """More X servers; they outlive every window: Tcl ends a process whose server is gone."""
    running: list[Display] = []

    def start(width: int, height: int) -> Display:
        running.append(Display(width, height))
        return running[-1]

    yield start
    for one in running:
        one.stop()


@pytest.fixture(scope="module")
def window(
    display: Display,
    tmp_path_factory: pytest.TempPathFactory,
    small_rig: Path,
    small_scene: Path,
    small_plan: Path,
) -> Iterator[Window]:
    """A window on the small simulated rig in real time; tests of a module share it, in order."""
    folder = tmp_path_factory.mktemp("window")
    rig = folder / "real-time.yaml"
    text = small_rig.read_text(encoding="utf-8")
    rig.write_text(f"{text}simulation: {{clock: real}}\n", encoding="utf-8")
    opened = Window(
        display,
        folder,
        rig=rig,
        scene=small_scene,
        plan=small_plan,
        scale=1.0,
        size=(1440, 900),
    )
    opened.connected()
    yield opened
    opened.close()


@pytest.fixture(autouse=True)
def _no_collection_elsewhere() -> Iterator[None]:
    """Let no other thread free a closed window: Tcl ends the process that does."""
    gc.disable()
    yield
    gc.collect()
    gc.enable()
