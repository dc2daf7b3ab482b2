"""The window: what stands where, what is remembered, and the beat that everything is polled at."""

from __future__ import annotations

import time
import tkinter as tk
from dataclasses import dataclass, replace
from pathlib import Path
from tkinter import ttk

from labrig.gui import settings as kept
from labrig.gui.bottom import Banner, Log, Status
from labrig.gui.bounces_tab import BouncesTab
from labrig.gui.browser import Browser
from labrig.gui.camera_card import CameraCard, FocusCard, HistogramCard
from labrig.gui.devices import Devices
from labrig.gui.field_tab import FieldTab
from labrig.gui.images import Map
from labrig.gui.keys import Keys
from labrig.gui.live_tab import LiveTab
from labrig.gui.outcomes import Outcomes
from labrig.gui.plan_card import CaptureCard, PatternCard
from labrig.gui.rail import Day, Rail
from labrig.gui.result_tabs import AttenuationTab, ReportTab, ResultTab, SeparationTab
from labrig.gui.settings import TABS, Settings
from labrig.gui.style import Style, monitor_scale
from labrig.gui.widgets import Tip

BEAT_MS = 15
LEAST = (1100, 680)
USUAL = (1440, 900)
TITLES = ("Live", "Separation", "Attenuation", "Bounces", "Light field", "Report")


@dataclass(frozen=True, slots=True, kw_only=True)
class Places:
    """Files the window begins with, and where the settings are kept."""

    rig: Path
    scene: Path
    plan: Path
    out: Path
    settings: Path


class App:
    """The window and all in it. One root per process; every call in the thread that made it."""

    def __init__(
        self, root: tk.Tk, places: Places, found: Settings, *, scale: float | None = None
    ) -> None:
        self.root, self.places, self.settings = root, places, found
        percent = found.scale_percent
        chosen = scale or (percent / 100.0 if percent else monitor_scale(root))
        self.style = Style(root, scale=chosen, step=found.text_step)
        self.style.apply(found.theme)
        self.day = Day()
        self.closed = False
        self.beats: list[float] = []
        self._after = ""
        root.title("labrig")
        self._size()
        self._build()
        self.devices = Devices(self)
        self.outcomes = Outcomes(self)
        self.keys = Keys(self)
        self._restore()
        root.protocol("WM_DELETE_WINDOW", self.close)
        self._after = root.after(BEAT_MS, self._beat)

    def px(self, size: float) -> int:
        """Return a length of scale 1 as screen pixels."""
        return self.style.px(size)

    # What stands where.

    def _size(self) -> None:
        root, px = self.root, self.style.px
        screen = (root.winfo_screenwidth(), root.winfo_screenheight())
        least = (min(px(LEAST[0]), screen[0]), min(px(LEAST[1]), screen[1]))
        wanted = (self.settings.width or px(USUAL[0]), self.settings.height or px(USUAL[1]))
        size = [min(max(w, low), s) for w, low, s in zip(wanted, least, screen, strict=True)]
        root.minsize(*least)
        root.geometry(f"{size[0]}x{size[1]}+0+0")

    def _build(self) -> None:
        root, px = self.root, self.style.px
        root.columnconfigure(1, weight=1)
        root.rowconfigure(2, weight=1)
        self._build_head()
        self.banner = Banner(root, self.style, self.show_log)
        self.banner.grid(row=1, column=0, columnspan=3, sticky="ew")
        self.banner.hide()
        left = ttk.Frame(root, width=px(224))
        left.grid(row=2, column=0, sticky="ns", padx=(px(8), px(4)))
        left.pack_propagate(False)
        self.rail = Rail(left, self.style, self.go)
        self.rail.pack(fill="x", pady=(0, px(6)))
        self.browser = Browser(
            left,
            self.style,
            chosen=lambda entry: self.outcomes.open(entry),
            resume=lambda: self.devices.resume(),
            compare=lambda: self.outcomes.compare(),
        )
        self.browser.pack(fill="both", expand=True)
        self._build_tabs()
        self._build_right()
        self.log = Log(root, self.style, self.places.settings.with_name("window.log"))
        self.log.grid(row=3, column=0, columnspan=3, sticky="ew", padx=px(8), pady=(px(6), 0))
        self.status = Status(root, self.style, self.abort)
        self.status.grid(row=4, column=0, columnspan=3, sticky="ew")

    def _build_head(self) -> None:
        px = self.style.px
        head = ttk.Frame(self.root, padding=(px(10), px(5), px(8), px(5)))
        head.grid(row=0, column=0, columnspan=3, sticky="ew")
        self.name = ttk.Label(head, text="no session", style="Title.TLabel")
        self.name.pack(side="left")
        self.about = ttk.Label(head, text="", style="Dim.TLabel")
        self.about.pack(side="left", padx=px(12))
        self.theme_button = ttk.Button(
            head, text="Light  F9", style="Tool.TButton", command=self.switch_theme
        )
        self.theme_button.pack(side="right")
        help_button = ttk.Button(
            head, text="Keys  F1", style="Tool.TButton", command=lambda: self.keys.help()
        )
        help_button.pack(side="right", padx=px(4))
        self.lights = {
            name: ttk.Label(head, text=f"○ {name}", style="Dim.TLabel")
            for name in ("Disk", "Projector", "Camera")
        }
        for light in self.lights.values():
            light.pack(side="right", padx=px(8))

    def _build_tabs(self) -> None:
        px = self.style.px
        self.tabs = ttk.Notebook(self.root)
        self.tabs.grid(row=2, column=1, sticky="nsew", padx=px(4))
        self.live = LiveTab(
            self.tabs,
            self.style,
            hold=lambda on: self.devices.hold(paused=on),
            snap=lambda: self.devices.snap(),
            roi=lambda roi: self.devices.set_roi(roi),
            colours=self.set_map,
            drawer=lambda what: self.devices.open_drawer(what),
            run=lambda word: self.devices.command(word),
        )
        self.separation = SeparationTab(self.tabs, self.style)
        self.attenuation = AttenuationTab(self.tabs, self.style)
        self.bounces = BouncesTab(
            self.tabs,
            self.style,
            reweight=lambda sigma_s: self.outcomes.reweight(sigma_s),
            price=lambda tolerance: self.outcomes.price(tolerance),
            pay=lambda tolerance: self.outcomes.pay(tolerance),
        )
        self.field = FieldTab(self.tabs, self.style)
        self.report = ReportTab(
            self.tabs,
            self.style,
            export=lambda kinds: self.outcomes.export(kinds),
            page=lambda: self.outcomes.write_page(),
        )
        self.result_tabs: tuple[ResultTab, ...] = (
            self.separation,
            self.attenuation,
            self.bounces,
            self.field,
            self.report,
        )
        for tab, title in zip((self.live, *self.result_tabs), TITLES, strict=True):
            self.tabs.add(tab, text=title)
        self.tabs.bind("<<NotebookTabChanged>>", lambda _e: self._tab_changed())

    def _build_right(self) -> None:
        px = self.style.px
        right = ttk.Frame(self.root, width=px(238))
        right.grid(row=2, column=2, sticky="ns", padx=(px(4), px(8)))
        right.pack_propagate(False)
        self.histogram = HistogramCard(right, self.style)
        self.camera = CameraCard(
            right,
            self.style,
            expose=lambda e, g: self.devices.expose(e, g),
            auto=lambda: self.devices.metering.auto_expose(),
            roi=lambda roi: self.devices.set_roi(roi),
        )
        self.focus = FocusCard(right, self.style)
        self.pattern = PatternCard(
            right,
            self.style,
            show=lambda what: self.devices.show(what),
            change=lambda **changes: self.devices.change_plan(**changes),
        )
        self.capture = CaptureCard(right, self.style, lambda: self.devices.capture())
        # the button keeps its place; what is above gives way in a low window
        self.capture.pack(side="bottom", fill="x")
        for card in (self.camera, self.focus, self.pattern):
            card.pack(fill="x", pady=(0, px(4)))
        self.histogram.pack(fill="both", expand=True, pady=(0, px(4)), before=self.camera)
        Tip(
            self.histogram.canvas,
            self.style,
            "Raw counts of the region that is read; the right edge is the white level",
        )

    # What the operator does with the window itself.

    def go(self, step: int) -> None:
        """Lead to the controls of a step."""
        targets = (
            lambda: self._focus(0, self.live.pane),
            lambda: self._focus(0, self.pattern.box),
            lambda: self._focus(0, self.camera.exposure.entry),
            lambda: self._focus(0, self.capture.button),
            lambda: self._focus(1, self.separation),
            lambda: self._focus(5, self.report.button),
        )
        targets[step]()

    def _focus(self, tab: int, widget: tk.Misc) -> None:
        self.show_tab(tab)
        widget.focus_set()

    def show_tab(self, number: int) -> None:
        """Show a tab by its place."""
        self.tabs.select(number)  # type: ignore[no-untyped-call]

    @property
    def tab(self) -> int:
        """The place of the tab that is shown."""
        return int(self.tabs.index("current"))  # type: ignore[no-untyped-call]

    def _tab_changed(self) -> None:
        if self.tab == 0:
            self.live.refresh()
        else:
            self.outcomes.show_tab(self.tab)

    def switch_theme(self) -> None:
        """Change between dark and light."""
        self.style.apply("light" if self.style.palette.name == "dark" else "dark")
        self.recolour()

    def enlarge(self, by: int) -> None:
        """Make the text larger or smaller."""
        self.style.step = 0 if by == 0 else min(max(self.style.step + by, -3), 8)
        self.style.apply()
        self.recolour()

    def recolour(self) -> None:
        """Let everything that draws by itself take the colours of the palette."""
        other = "Light" if self.style.palette.name == "dark" else "Dark"
        self.theme_button.configure(text=f"{other}  F9")
        self.log.recolour()
        self.live.recolour()
        for tab in self.result_tabs:
            tab.recolour()
        self.histogram.show(self.histogram.meter)
        self.focus.show()

    def set_map(self, name: Map) -> None:
        """Show pictures in other colours."""
        self.live.set_map(name)
        panes = [*self.separation.panes, *self.bounces.panes, *(h.pane for h in self.field.halves)]
        for pane in panes:
            pane.look.colours = name
            pane.refresh()

    def toggle_log(self) -> None:
        """Show the log, or hide it."""
        if self.log.winfo_ismapped():
            self.log.grid_remove()
        else:
            self.show_log()

    def show_log(self) -> None:
        """Show the log, its last line in sight."""
        self.log.grid()
        self.log.text.see("end")

    def say(self, level: str, text: str) -> None:
        """Write a line into the log."""
        self.log.say(level, text)

    def abort(self) -> None:
        """Stop what runs: the run first, else the analysis."""
        if not self.devices.abort():
            self.outcomes.abort()

    def judge(self, **changes: object) -> None:
        """Note what has changed of the day, and tick the steps by their rules."""
        self.day = replace(self.day, **changes)  # type: ignore[arg-type]
        self.rail.show(self.day)

    # What is remembered, and the beat.

    def _restore(self) -> None:
        found = self.settings
        self.set_map(found.colours)  # type: ignore[arg-type]
        self.recolour()
        if found.log_open == "no":
            self.log.grid_remove()
        self.show_tab(TABS.index(found.tab))
        self.rail.show(self.day)
        self.live.pane.focus_set()

    def remember(self) -> str:
        """Keep the settings; return why they could not be kept."""
        now = replace(
            self.settings,
            theme=self.style.palette.name,
            text_step=self.style.step,
            width=self.root.winfo_width(),
            height=self.root.winfo_height(),
            tab=TABS[self.tab],
            log_open="yes" if self.log.grid_info() else "no",
            colours=self.live.map.get(),
            rig=str(self.places.rig),
            scene=str(self.places.scene),
            plan=str(self.places.plan),
            out=str(self.places.out),
            **self.devices.remembered(),
        )
        return kept.save(self.places.settings, now)

    def _beat(self) -> None:
        self.beats.append(time.monotonic())
        del self.beats[:-20000]
        self.devices.poll()
        self.outcomes.poll()
        if not self.closed:
            self._after = self.root.after(BEAT_MS, self._beat)

    def close(self) -> None:
        """Keep the settings, end what runs with a dark projector, and let the window go."""
        if self.closed:
            return
        self.closed = True
        self.root.after_cancel(self._after)
        self.remember()
        self.devices.close()
        self.outcomes.close()
        self.root.destroy()
