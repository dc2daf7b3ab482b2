"""What is below and above everything: log, progress with the time left, abort, and the banner."""

from __future__ import annotations

import time
import tkinter as tk
from collections.abc import Callable
from pathlib import Path
from tkinter import ttk

from labrig.gui.style import Style
from labrig.gui.widgets import Tip

LINES = 500


class Log(ttk.Frame):
    """The last lines of what happened, each with its time and level in a word."""

    def __init__(self, parent: tk.Misc, style: Style, file: Path | None) -> None:
        px = style.px
        super().__init__(parent, style="Field.TFrame")
        self._style, self._file = style, file
        self.lines: list[tuple[str, str, str]] = []
        self.text = tk.Text(
            self,
            height=3,
            wrap="none",
            borderwidth=0,
            highlightthickness=1,
            takefocus=True,
            state="disabled",
            padx=px(8),
            pady=px(3),
            undo=False,
        )
        self.text.pack(fill="both", expand=True)
        self.text.bind("<Configure>", lambda _e: self.text.see("end"))
        self.recolour()

    def recolour(self) -> None:
        """Take the colours of the palette."""
        p, text = self._style.palette, self.text
        text.configure(
            background=p.field,
            foreground=p.text,
            font=self._style.font("mono"),
            highlightbackground=p.line,
            highlightcolor=p.accent,
            selectbackground=p.select,
            selectforeground=p.on_select,
            insertbackground=p.field,
        )
        for level, colour in (("info", p.text), ("warn", p.warn), ("error", p.bad)):
            text.tag_configure(level, foreground=colour)

    def say(self, level: str, said: str) -> None:
        """Add a line, to the file as well."""
        line = (time.strftime("%H:%M:%S"), level, said)
        self.lines = [*self.lines[-LINES:], line]
        word = {"info": "info ", "warn": "WARN ", "error": "ERROR"}[level]
        self.text.configure(state="normal")
        start = "\n" if self.text.index("end-1c") != "1.0" else ""
        self.text.insert("end", f"{start}{line[0]}  {word}  {said}", level)
        if int(self.text.index("end-1c").split(".")[0]) > LINES:
            self.text.delete("1.0", "2.0")
        self.text.configure(state="disabled")
        self.text.see("end")
        self.text.xview_moveto(0.0)
        if self._file is not None:
            try:
                self._file.parent.mkdir(parents=True, exist_ok=True)
                with self._file.open("a", encoding="utf-8") as file:
                    file.write(f"{time.strftime('%Y-%m-%d')} {line[0]} {word} {said}\n")
            except OSError:
                self._file = None  # the window's own lines go on

    def give_way(self, *, low: bool) -> None:
        """Show a line alone in a low window, so that what stands above keeps its room."""
        self.text.configure(height=1 if low else 3)

    def copy(self) -> None:
        """Put every line on the clipboard."""
        self.clipboard_clear()
        self.clipboard_append("\n".join(f"{a}  {b}  {c}" for a, b, c in self.lines))


class Status(ttk.Frame):
    """How far what runs is, in a bar and in words, and the button that stops it."""

    def __init__(self, parent: tk.Misc, style: Style, abort: Callable[[], None]) -> None:
        px = style.px
        super().__init__(parent, padding=(px(8), px(4)))
        self.abort = ttk.Button(self, text="Abort  Esc", style="Bad.TButton", command=abort)
        self.abort.pack(side="right", padx=(px(8), 0))
        Tip(self.abort, style, "Stops what runs at once; what was saved stays saved")
        self.bar = ttk.Progressbar(self, length=px(300), maximum=1.0)
        self.bar.pack(side="left")
        self.text = ttk.Label(self, text="")
        self.text.pack(side="left", padx=px(12), fill="x", expand=True)

    def show(self, text: str, share: float | None, *, running: bool) -> None:
        """Show words, and a share of one; None where there is nothing to count."""
        if self.text.cget("text") != text:
            self.text.configure(text=text)
        self.bar.configure(value=0.0 if share is None else share)
        self.abort.state(["!disabled" if running else "disabled"])


class Banner(ttk.Frame):
    """Trouble: what happened, what is safe, and what can be done. Nothing else ever shows here."""

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        log: Callable[[], None],
        changed: Callable[[bool], None],
    ) -> None:
        px = style.px
        super().__init__(parent, style="Banner.TFrame", padding=(px(10), px(5)))
        self._style = style
        self.actions = ttk.Frame(self, style="Banner.TFrame")
        self.actions.pack(side="right")
        self._details, self._changed = log, changed
        self.words = ttk.Label(self, style="Banner.TLabel", text="", justify="left")
        self.words.pack(side="left", fill="x", expand=True)
        self.bind(
            "<Configure>",
            lambda e: self.words.configure(
                wraplength=max(e.width - self.actions.winfo_reqwidth() - px(30), px(200))
            ),
        )
        self.text = ""

    def show(self, text: str, actions: list[tuple[str, Callable[[], None]]]) -> None:
        """Show trouble with its buttons; Details and Dismiss come by themselves."""
        self.text = text
        self.words.configure(text=f"✕  {text}")
        for child in self.actions.winfo_children():
            child.destroy()
        for name, act in (*actions, ("Details", self._details), ("Dismiss", self.hide)):
            ttk.Button(self.actions, text=name, command=act).pack(
                side="left", padx=(self._style.px(6), 0)
            )
        self.grid()
        self._changed(True)

    def hide(self) -> None:
        """Let the banner go."""
        self.text = ""
        self.grid_remove()
        self._changed(False)
