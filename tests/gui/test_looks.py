"""Nothing is cut, overlapped or out of the keyboard's reach; every tab shows something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from window import Open, Window, clipped, controls, overlapping, shown_of, tab_order

from labrig.gui.palette import PALETTES, ZEBRA, rgb
from labrig.station.shown import Price

TABS = range(6)


def faults(window: Window) -> list[str]:
    """What is cut, lies over another thing, or is not reached by Tab."""
    window.events()
    window.root.update_idletasks()
    reached = tab_order(window)
    missed = [f"{w} is not reached" for w in controls(window) if str(w) not in reached]
    return clipped(window) + overlapping(window) + missed


def all_looks(window: Window, root: Path) -> list[str]:
    """Faults of every tab with a result, every drawer, the banner, and the list of keys."""
    app, found = window.app, []
    app.outcomes.show(shown_of(root))
    app.field.compare(shown_of(root, 1))
    app.capture.planned(app.devices.plan, 1e-5)
    price = Price(tolerance=1e-2, engine="ordinates", grid="a grid", seconds=12.3, gigabytes=1.23)
    app.bounces.say_prices([price])
    for tab in TABS:
        app.show_tab(tab)
        found += [f"tab {tab}: {fault}" for fault in faults(window)]
    app.show_tab(0)
    for drawer in ("profile", "decomposition", "run"):
        app.live.drawer.show(drawer)
        found += [f"{drawer}: {fault}" for fault in faults(window)]
    app.live.drawer.show("")
    app.banner.show("The camera was unplugged. " * 6, [("Retry", lambda: None)])
    found += [f"banner: {fault}" for fault in faults(window)]
    app.banner.hide()
    app.keys.help()
    window.root.update_idletasks()
    found += [f"keys: {fault}" for fault in clipped(window)]
    app.keys.help()
    return found


@pytest.mark.parametrize(
    ("scale", "size"),
    [(1.0, (1100, 680)), (1.0, (1440, 900)), (1.5, (1650, 1020)), (2.0, (2200, 1360))],
)
def test_nothing_is_cut_and_tab_reaches_every_control(
    open_window: Open, results_root: Path, scale: float, size: tuple[int, int]
):
    """A10: also in a window as small as it may be."""
    window = open_window(size=size, scale=scale)
    window.app.devices.hold(paused=True)  # a still picture looks the same, and costs nothing
    assert (window.root.winfo_width(), window.root.winfo_height()) == size
    found = all_looks(window, results_root)
    assert not found, "\n".join(found)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_every_tab_shows_something_in_both_themes(
    open_window: Open, results_root: Path, theme: str
):
    """A12: no tab is blank, and each is another; the zebra and the banner have their colours."""
    window = open_window(theme=theme)
    app, seen = window.app, {}
    ground = rgb(PALETTES[theme].ground)
    app.devices.expose(1.0, 0.0)
    assert window.pump(lambda: app.live.picture.exposure_s == 1.0)
    app.devices.hold(paused=True)
    app.outcomes.show(shown_of(results_root))
    for tab in TABS:
        app.show_tab(tab)
        window.beats()
        picture = window.grab()
        middle = np.asarray(picture.crop(_box(app.tabs)))
        assert middle.std() > 8.0, tab
        assert len(np.unique(middle.reshape(-1, 3), axis=0)) > 30, tab
        assert picture.getpixel((2, 2)) == ground
        seen[tab] = middle
    for one in TABS:
        for other in range(one):
            assert np.mean(seen[one] != seen[other]) > 0.01, (one, other)
    for colour in ZEBRA:
        assert (seen[0] == colour).all(axis=2).sum() > 50
    app.banner.show("No frame for 2 s.", [("Retry", lambda: None)])
    window.beats()
    banner: Image.Image = window.grab().crop(_box(app.banner))
    bad = np.asarray(banner) == rgb(PALETTES[theme].bad)
    assert bad.all(axis=2).mean() > 0.5
    assert app.style.palette.name == theme


def _box(widget) -> tuple[int, int, int, int]:
    x = widget.winfo_rootx() - widget.winfo_toplevel().winfo_rootx()
    y = widget.winfo_rooty() - widget.winfo_toplevel().winfo_rooty()
    return x, y, x + widget.winfo_width(), y + widget.winfo_height()
