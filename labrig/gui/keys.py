"""Keys: every one of them in one table, which F1 shows; letters rest while a field is typed in."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from tkinter import ttk
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from labrig.gui.app import App

TYPED = ("TEntry", "TSpinbox", "TCombobox")


class Keys:
    """Binds the keys, and lists them."""

    def __init__(self, app: App) -> None:
        self._app = app
        self._window: tk.Toplevel | None = None
        live = app.live
        flip = self._flip
        self.anywhere: list[tuple[str, str, str, Callable[[], object]]] = [
            ("F1", "F1", "this list", self.help),
            ("F5", "F5", "capture the plan into a new session", lambda: app.devices.capture()),
            ("Esc", "Escape", "abort what runs; else close the banner", self._escape),
            ("F6", "F6", "to the sessions", lambda: app.browser.tree.focus_set()),
            ("F7", "F7", "analyse the chosen session", lambda: app.outcomes.analyse()),
            ("F8", "F8", "show or hide the log", app.toggle_log),
            ("F9", "F9", "dark or light", app.switch_theme),
            (
                "Ctrl 1 … 6",
                "",
                "Live, Separation, Attenuation, Bounces, Light field, Report",
                lambda: None,
            ),
            ("Ctrl F", "Control-f", "filter the sessions", lambda: app.browser.field.focus_set()),
            ("Ctrl R", "Control-r", "resume the chosen session", lambda: app.devices.resume()),
            (
                "Ctrl K",
                "Control-k",
                "compare with the result seen before",
                lambda: app.outcomes.compare(),
            ),
            ("Ctrl E", "Control-e", "export the result", lambda: app.outcomes.export()),
            ("Ctrl L", "Control-l", "copy the log", app.log.copy),
            ("Ctrl + − 0", "", "larger, smaller, usual text", lambda: None),
            ("Ctrl Q", "Control-q", "close the window", app.close),
        ]
        self.letters: list[tuple[str, str, str, Callable[[], object]]] = [
            (
                "Space",
                "space",
                "hold the live picture",
                lambda: flip(live.tools["pause"]),
            ),
            ("S", "s", "keep this frame as a 16-bit TIFF", lambda: app.devices.snap()),
            (
                "A",
                "a",
                "automatic exposure and bracket",
                lambda: app.devices.metering.auto_expose(),
            ),
            ("0", "0", "the whole picture", self._fit),
            ("1", "1", "a pixel on a pixel", live.one),
            ("Z", "z", "zebra over clipped pixels", lambda: flip(live.tools["zebra"])),
            ("V", "v", "square-root scale", lambda: flip(live.tools["root"])),
            ("R", "r", "region that is read", lambda: flip(live.tools["roi"])),
            ("P", "p", "profile along the beam", lambda: flip(live.tools["profile"])),
            (
                "D",
                "d",
                "live separation and fit",
                lambda: flip(live.tools["fit live"]),
            ),
            ("arrows", "", "in a picture: read the next pixel; Shift ten, Ctrl pans", lambda: None),
            ("+  −", "", "in a picture: zoom at the read pixel", lambda: None),
        ]
        self._bind()

    def _bind(self) -> None:
        root, app = self._app.root, self._app
        for _, key, _, act in self.anywhere:
            if key:
                root.bind(f"<{key}>", lambda _e, act=act: self._do(act))  # type: ignore[misc]
        for k in range(6):
            root.bind(f"<Control-Key-{k + 1}>", lambda _e, k=k: self._do(lambda: app.show_tab(k)))  # type: ignore[misc]
        for key, by in (
            ("plus", 1),
            ("equal", 1),
            ("KP_Add", 1),
            ("minus", -1),
            ("KP_Subtract", -1),
            ("0", 0),
        ):
            root.bind(f"<Control-Key-{key}>", lambda _e, by=by: self._do(lambda: app.enlarge(by)))  # type: ignore[misc]
        for _, key, _, act in self.letters:
            if key:
                root.bind(f"<Key-{key}>", lambda e, act=act: self._letter(e, act))  # type: ignore[misc]
                if len(key) == 1 and key.isalpha():
                    root.bind(f"<Key-{key.upper()}>", lambda e, act=act: self._letter(e, act))  # type: ignore[misc]

    def _do(self, act: Callable[[], object]) -> str:
        act()
        return "break"

    def _letter(self, event: tk.Event[tk.Misc], act: Callable[[], object]) -> str | None:
        widget = event.widget
        state = int(event.state)
        if state & 0x0C or self._typing(widget):  # Control or Alt belongs to others
            return None
        if event.keysym == "space" and isinstance(widget, ttk.Button | ttk.Checkbutton):
            return None  # the button that has the focus is pressed
        act()
        return "break"

    def _typing(self, widget: tk.Misc) -> bool:
        if not isinstance(widget, tk.Misc) or widget.winfo_class() not in TYPED:
            return False
        return "readonly" not in widget.state()  # type: ignore[attr-defined]

    def _flip(self, widget: ttk.Widget) -> None:
        if "disabled" not in widget.state():
            widget.invoke()  # type: ignore[attr-defined]

    def _fit(self) -> None:
        app = self._app
        panes = {
            0: app.live.pane,
            1: app.separation.panes[0],
            3: app.bounces.panes[0],
            4: app.field.halves[0].pane,
        }
        if app.tab in panes:
            panes[app.tab].fit()

    def _escape(self) -> None:
        if self._window is not None:
            self._close()
        elif self._app.devices.running or self._app.outcomes.busy:
            self._app.abort()
        else:
            self._app.banner.hide()

    def help(self) -> None:
        """Show the keys; the same key closes the list."""
        if self._window is not None:
            self._close()
            return
        app = self._app
        style, px = app.style, app.style.px
        window = tk.Toplevel(app.root, background=style.palette.accent)
        window.title("Keys")
        window.transient(app.root)
        self._window = window
        body = ttk.Frame(window, style="Card.TFrame", padding=px(16))
        body.pack(fill="both", expand=True, padx=px(1), pady=px(1))
        for column, (heading, table) in enumerate(
            (("ANYWHERE", self.anywhere), ("UNLESS A FIELD IS TYPED IN", self.letters))
        ):
            ttk.Label(body, text=heading, style="Head.TLabel").grid(
                row=0, column=2 * column, columnspan=2, sticky="w", pady=(0, px(6))
            )
            for row, (key, _, what, _) in enumerate(table, start=1):
                ttk.Label(body, text=key, style="CardBold.TLabel").grid(
                    row=row, column=2 * column, sticky="w", padx=(0, px(12)), pady=px(1)
                )
                ttk.Label(body, text=what, style="Card.TLabel", wraplength=px(300)).grid(
                    row=row, column=2 * column + 1, sticky="w", padx=(0, px(28))
                )
        for key in ("<Escape>", "<F1>"):
            window.bind(key, lambda _e: self._do(self._close))
        window.protocol("WM_DELETE_WINDOW", self._close)
        window.update_idletasks()
        x = app.root.winfo_rootx() + (app.root.winfo_width() - window.winfo_reqwidth()) // 2
        y = app.root.winfo_rooty() + (app.root.winfo_height() - window.winfo_reqheight()) // 2
        window.geometry(f"+{max(x, 0)}+{max(y, 0)}")
        window.focus_set()

    def _close(self) -> None:
        if self._window is not None:
            self._window.destroy()
            self._window = None
            self._app.live.pane.focus_set()
