"""The live picture and the controls beside it: what is shown is what the camera gave."""

from __future__ import annotations

import contextlib
import threading
import time
import tkinter as tk
from tkinter import ttk

import numpy as np
import pytest
import tifffile
from window import Window, strike, widgets

from labrig.gui.palette import ZEBRA


@pytest.mark.parametrize("zoom", [0.25, 1.0, 8.0])
def test_readout_is_the_raw_count_under_the_pixel(window: Window, zoom: float):
    """A8: a hundred random pixels of the picture, ten after each of ten pans."""
    live, rng = window.app.live, np.random.default_rng(1)
    window.key("Key-space", live.pane)
    live.pane.set_view(live.pane.view.at(zoom))
    for _ in range(10):
        live.pane.set_view(live.pane.view.panned(*rng.uniform(-30, 30, 2)))
        view = live.pane.view
        cols, rows = (
            np.arange(max(first, 0), min(first + size / zoom, n)).astype(int)
            for first, size, n in (
                (view.left, view.width, view.cols),
                (view.top, view.height, view.rows),
            )
        )
        for col, row in zip(rng.choice(cols[1:-1], 10), rng.choice(rows[1:-1], 10), strict=True):
            x, y = (int(v) for v in view.to_pane(col + 0.5, row + 0.5))
            live.pane.event_generate("<Motion>", x=x + 1, y=y + 1)
            at = live.pane.read_at
            assert at == (col, row) if zoom >= 1.0 else view.pixel(x, y)
            counts = int(live.picture.pixels[at[1], at[0]])
            words = f"x {at[0]:4d} y {at[1]:4d} {counts:5d} DN {100 * counts / 4095:5.1f} %"
            assert live.readings[0].cget("text") == words


def test_shares_that_are_shown_are_those_of_the_frame_that_is_kept(window: Window):
    """A7: the clipped and the dark share beside the histogram, from the raw counts on the disk."""
    app = window.app
    app.devices.expose(1.0, 0.0)
    bright = window.pump(
        lambda: app.live.picture.exposure_s == 1.0 and app.histogram.meter.saturated > 0.01
    )
    assert bright
    window.key("Key-space", app.live.pane)  # hold
    last, since = app.live.picture, time.monotonic()

    def at_rest() -> bool:  # a picture may be on its way
        nonlocal last, since
        if app.live.picture is not last:
            last, since = app.live.picture, time.monotonic()
        return time.monotonic() - since > 1.0

    assert window.pump(at_rest)
    app.devices.metering.take(app.live.picture)
    window.key("Key-s", app.live.pane)
    (path,) = app.places.out.glob("snaps/*.tif")
    counts = tifffile.imread(path)
    path.unlink()
    np.testing.assert_array_equal(counts, app.live.picture.pixels)
    saturated = 100 * np.mean(counts >= 4095)
    dark = 100 * np.mean(counts < 16 + 0.01 * (4095 - 16))
    mark, words = "!", app.histogram.words.cget("text")
    assert words == f"{mark}sat {saturated:4.1f} %  dark {dark:4.1f} %"


def test_zebra_is_seen_where_the_picture_clips(window: Window):
    app = window.app
    app.devices.expose(1.0, 0.0)
    assert window.pump(lambda: app.live.picture.exposure_s == 1.0)
    window.beats()

    def hatched(colour: tuple[int, int, int]) -> int:
        pixels = np.asarray(app.live.pane.painted).reshape(-1, 3)
        return int((pixels == colour).all(axis=1).sum())

    assert min(hatched(colour) for colour in ZEBRA) > 50
    window.key("Key-z", app.live.pane)
    assert not app.live.zebra.get()
    assert max(hatched(colour) for colour in ZEBRA) == 0
    window.key("Key-z", app.live.pane)
    assert min(hatched(colour) for colour in ZEBRA) > 50


def test_the_range_that_is_shown_is_fixed_and_a_stretch_is_named(window: Window):
    app = window.app
    look = app.live.pane.look
    assert (look.low, look.high, look.root) == (0.0, 4095.0, False)
    app.devices.expose(0.2, 0.0)
    assert window.pump(lambda: app.live.picture.exposure_s == 0.2)
    assert (look.low, look.high) == (0.0, 4095.0)
    before = np.asarray(app.live.pane.painted).copy()
    window.key("Key-v", app.live.pane)
    assert look.root
    texts = [
        app.live.pane.itemcget(item, "text")
        for item in app.live.pane.find_withtag("mark")
        if app.live.pane.type(item) == "text"
    ]
    assert any("√" in text for text in texts)
    assert np.asarray(app.live.pane.painted).mean() > before.mean()
    window.key("Key-v", app.live.pane)
    assert not look.root


def test_what_the_camera_or_the_plan_refuses_goes_back_with_the_reason(window: Window):
    app = window.app
    app.devices.expose(1e4, 0.0)
    assert window.pump(lambda: window.said("outside"))
    assert app.camera.exposure.value.get() == "50"
    app.devices.change_plan(shifts=5)
    assert window.pump(lambda: window.said("does not divide"))
    assert window.pump(lambda: app.pattern.shifts.value.get() == "6")


def test_letters_are_typed_and_not_obeyed_in_a_field(window: Window):
    field = window.app.browser.field
    field.focus_force()
    held = window.app.live.paused.get()
    for key in ("z", "p", "a"):
        window.key(f"Key-{key}", field)
    assert window.app.browser.filter.get() == "zpa"
    assert window.app.live.drawer.open == ""
    assert window.app.live.zebra.get()
    assert window.app.live.paused.get() == held
    window.app.browser.filter.set("")


def test_the_profile_along_the_beam_falls_with_depth(window: Window):
    live = window.app.live
    window.key("Key-p", live.pane)
    assert window.pump(lambda: live.drawer.plot.chart.curves)
    light = live.drawer.plot.chart.curves[0].y
    assert light[:20].mean() > 3 * light[-40:].mean()
    window.key("Key-p", live.pane)
    assert live.drawer.open == ""


@pytest.mark.parametrize("kind", ["camera-lost", "projector-lost"])
def test_a_lost_device_is_said_and_retry_brings_it_back(window: Window, kind: str):
    """A6; how soon it is said is printed by `make bench-gui`."""
    app = window.app
    strike(window, kind)
    if kind == "projector-lost":
        app.devices.show("white")  # which asks something of the projector
    assert window.pump(lambda: app.banner.text), window.log
    assert kind.removesuffix("-lost") in app.banner.text.lower()
    assert "lost" in app.banner.text  # ... and that nothing that was saved is
    assert app.rail.states[0] != "done"
    assert "disabled" in app.capture.button.state()
    assert "Retry" in app.capture._why
    retry = app.banner.actions.winfo_children()[0]
    assert retry.cget("text") == "Retry"
    app.live.picture = None
    retry.invoke()
    assert window.pump(lambda: app.live.picture is not None), window.log
    assert app.banner.text == ""
    assert "disabled" not in app.capture.button.state()


def test_silence_is_said(window: Window):
    strike(window, "drop", times=10_000)
    assert window.pump(lambda: "no frame" in window.app.banner.text.lower())
    window.app.devices.retry()
    assert window.pump(lambda: not window.app.banner.text)


def test_a_black_picture_is_explained(window: Window):
    window.app.devices.expose(0.0001, 0.0)
    assert window.pump(lambda: window.said("raise the exposure"))


def test_widgets_are_ttk_but_canvases_and_text(window: Window):
    plain = {w.winfo_class() for w in widgets(window.root)} - {"Canvas", "Text"}
    assert all(name.startswith("T") for name in plain), plain
    assert isinstance(window.app.tabs, ttk.Notebook)


def test_a_call_of_another_thread_is_heard(window: Window):
    """That `window.Watched` hears what every other test here relies on it to hear."""

    def call() -> None:
        with contextlib.suppress(tk.TclError, RuntimeError):  # not in main loop
            window.root.winfo_width()

    thread = threading.Thread(target=call, name="stranger")
    thread.start()
    assert window.pump(lambda: not thread.is_alive())
    heard = window.calls_of_other_threads
    assert {line.split(":")[0] for line in heard} == {"stranger"}
    heard.clear()
