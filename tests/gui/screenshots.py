"""The pictures of the operator's guide, from the simulated rig: `make screenshots`."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image
from window import CONFIGS, ROOT, Display, Window

LIMIT_S = 600.0


def keep(window: Window, folder: Path, name: str) -> None:
    """Write the window as a picture of 256 colours."""
    window.pump(limit_s=1.0)
    colours = window.grab().quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    colours.save(folder / f"{name}.png", optimize=True)
    print(name, flush=True)


def take(window: Window, folder: Path, theme: str, *, whole: bool) -> None:
    """Take the pictures of a day; the capture is made once, by the first theme."""
    app = window.app
    window.pump(lambda: app.focus.readings > 8, LIMIT_S)
    app.live.pane.read(160, 480)
    keep(window, folder, f"{theme}-live")
    window.key("Key-p", app.live.pane)
    window.pump(lambda: app.live.drawer.plot.chart.curves, LIMIT_S)
    keep(window, folder, f"{theme}-profile")
    window.key("Key-d", app.live.pane)
    window.pump(lambda: app.live.drawer.live.count > 4, LIMIT_S)
    keep(window, folder, f"{theme}-live-fit")
    window.key("Key-d", app.live.pane)
    if whole:
        app.devices.capture()
        window.pump(lambda: app.devices.run and app.devices.run.saved > 13, LIMIT_S)
        keep(window, folder, f"{theme}-capture")
        window.pump(lambda: not app.devices.running, LIMIT_S)
        window.pump(lambda: app.outcomes.shown is not None, LIMIT_S)
    else:
        window.pump(lambda: app.browser.entries, LIMIT_S)
        app.browser.tree.selection_set(app.browser.tree.get_children()[-1])
        window.pump(lambda: app.outcomes.shown is not None, LIMIT_S)
    for number, name in enumerate(
        ("separation", "attenuation", "bounces", "light-field", "report")
    ):
        app.show_tab(number + 1)
        if name == "bounces":
            window.pump(lambda: "MB" in app.bounces.price_words.cget("text"), LIMIT_S)
        keep(window, folder, f"{theme}-{name}")
    app.show_tab(0)
    window.key("F1")
    keep(window, folder, f"{theme}-keys")
    window.key("Escape")
    app.devices.hold(paused=True)
    window.pump(limit_s=2.0)  # a picture that still comes would end the silence
    app.devices._tell_silence(2.0)
    keep(window, folder, f"{theme}-banner")
    app.banner.hide()


def main() -> int:
    """Take every picture, dark and light."""
    folder = ROOT / "docs" / "images" / "window"
    folder.mkdir(parents=True, exist_ok=True)
    display = Display(1440, 900)
    with tempfile.TemporaryDirectory() as name:
        for theme in ("dark", "light"):
            window = Window(
                display,
                Path(name),
                rig=CONFIGS / "rigs" / "simulated-live.yaml",
                scale=1.0,
                size=(1440, 900),
                theme=theme,
                tab="live",
                exposure_s=0.06,
            )
            window.connected(LIMIT_S)
            take(window, folder, theme, whole=theme == "dark")
            window.close()
    display.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
