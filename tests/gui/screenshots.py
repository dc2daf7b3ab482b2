"""The pictures of the operator's guide, from the simulated rig: `make screenshots`.

``screenshots.py FOLDER`` writes every tab in the smallest window and at twice the scale as well.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image
from window import CONFIGS, ROOT, Display, Window, strike

import labrig

LIMIT_S = 900.0
SLANT_DEG = 30
RESULTS = ("separation", "attenuation", "bounces", "light-field", "report")
TINY, TWICE = ((1100, 680), 1.0), ((2200, 1360), 2.0)


def keep(window: Window, folder: Path, name: str) -> None:
    """Write the window as a picture of 256 colours."""
    window.pump(limit_s=1.0)
    colours = window.grab().quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    colours.save(folder / f"{name}.png", optimize=True)
    print(name, flush=True)


def slanted(out: Path) -> None:
    """Capture and analyse the milk of the guide once more, lit aslant."""
    text = (CONFIGS / "scenes" / "dilute-milk.yaml").read_text(encoding="utf-8")
    scene = out.parent / "slanted.yaml"
    text = text.replace("angle_deg: 0", f"angle_deg: {SLANT_DEG}")
    scene.write_text(text.replace("n_paths: 3000000", "n_paths: 400000"), encoding="utf-8")
    plan = labrig.load_plan(CONFIGS / "plans" / "six-shifts.yaml")
    with labrig.open_rig(CONFIGS / "rigs" / "simulated.yaml", scene, plan) as rig:
        labrig.analyse(labrig.capture(plan, rig, out))


def live(window: Window, folder: Path, theme: str) -> None:
    """Take the live view, its profile and its fit."""
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


def capture(window: Window, folder: Path, theme: str) -> None:
    """Run the plan, and wait for its result."""
    app = window.app
    app.devices.capture()
    window.pump(lambda: app.devices.run and app.devices.run.saved > 13, LIMIT_S)
    keep(window, folder, f"{theme}-capture")
    window.pump(lambda: not app.devices.running, LIMIT_S)
    window.pump(lambda: app.outcomes.shown is not None, LIMIT_S)


def results(window: Window, folder: Path, theme: str) -> None:
    """Take every tab of the result that is shown."""
    app = window.app
    for number, name in enumerate(RESULTS, start=1):
        app.show_tab(number)
        if name == "bounces":
            window.pump(lambda: "MB" in app.bounces.price_words.cget("text"), LIMIT_S)
        keep(window, folder, f"{theme}-{name}")


def choose(window: Window, row: int) -> None:
    """Choose a session of the list."""
    app = window.app
    window.pump(lambda: len(app.browser.entries) > row, LIMIT_S)
    chosen = app.browser.tree.get_children()[row]
    app.browser.tree.selection_set(chosen)
    name = Path(chosen).name
    window.pump(lambda: app.outcomes.shown and app.outcomes.shown.title == name, LIMIT_S)


def rest(window: Window, folder: Path, theme: str) -> None:
    """Take the comparison, the list of keys and the banner."""
    app = window.app
    choose(window, 1)
    choose(window, 0)
    app.outcomes.compare()
    keep(window, folder, f"{theme}-compare")
    app.field.alone.invoke()
    app.show_tab(0)
    window.key("F1")
    keep(window, folder, f"{theme}-keys")
    window.key("Escape")
    strike(window, "camera-lost")
    window.pump(lambda: app.banner.text, LIMIT_S)
    keep(window, folder, f"{theme}-banner")


def opened(
    display: Display, folder: Path, theme: str, *, size: tuple[int, int], scale: float = 1.0
) -> Window:
    """Open the window on the simulated rig in real time."""
    window = Window(
        display,
        folder,
        rig=CONFIGS / "rigs" / "simulated-live.yaml",
        scale=scale,
        size=size,
        theme=theme,
        tab="live",
        exposure_s=0.06,
    )
    window.connected()
    return window


def main() -> int:
    """Take every picture, dark and light."""
    folder = ROOT / "docs" / "images" / "window"
    folder.mkdir(parents=True, exist_ok=True)
    displays = [Display(*size) for size in ((1440, 900), TINY[0], TWICE[0])]  # outlive the windows
    with tempfile.TemporaryDirectory() as name:
        data = Path(name)
        slanted(data / "sessions")
        for theme in ("dark", "light"):
            window = opened(displays[0], data, theme, size=(1440, 900))
            live(window, folder, theme)
            if theme == "dark":
                capture(window, folder, theme)
            else:
                choose(window, 0)
            results(window, folder, theme)
            rest(window, folder, theme)
            window.close()
        if sys.argv[1:]:
            more = Path(sys.argv[1])
            more.mkdir(parents=True, exist_ok=True)
            for display, (size, scale), theme in zip(
                displays[1:], (TINY, TWICE), ("dark", "light"), strict=True
            ):
                window = opened(display, data, theme, size=size, scale=scale)
                live(window, more, f"{scale:g}")
                choose(window, 0)
                results(window, more, f"{scale:g}")
                rest(window, more, f"{scale:g}")
                window.close()
    for display in displays:
        display.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
