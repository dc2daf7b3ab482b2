"""The sessions below the data root: filter, state in a word and a symbol, open, resume, compare."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from pathlib import Path
from tkinter import ttk

from labrig.gui.style import Style
from labrig.gui.widgets import Card, Tip
from labrig.station.shown import Listed

SYMBOLS = {
    "completed": "✓ captured",
    "running": "▶ running",
    "aborted": "◐ partial",
    "interrupted": "◐ partial",
    "failed": "! failed",
    "damaged": "✕ damaged",
}


def word_of(entry: Listed) -> str:
    """Return a session's state as the browser says it."""
    if entry.state == "completed" and entry.fitted:
        return "✓ fitted"
    word = SYMBOLS.get(entry.state, entry.state)
    if word.startswith("◐"):
        return f"{word} {entry.saved}/{entry.planned}"
    return word


class Browser(Card):
    """The list of sessions."""

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        *,
        chosen: Callable[[Listed], None],
        resume: Callable[[], None],
        compare: Callable[[], None],
    ) -> None:
        super().__init__(parent, style, "Sessions")
        px = style.px
        self.entries: list[Listed] = []
        self._chosen = chosen
        self._last: Path | None = None
        self.filter = tk.StringVar(self)
        self.field = ttk.Entry(self.body, textvariable=self.filter, font=style.font())
        self.field.pack(fill="x", pady=(0, px(4)))
        Tip(self.field, style, "Filter by name, date or state; Return goes to the list")
        self.field.bind("<Return>", self._to_list)
        self.filter.trace_add("write", lambda *_: self._fill())
        row = ttk.Frame(self.body, style="Card.TFrame")
        row.pack(side="bottom", fill="x", pady=(px(4), 0))
        self.resume = ttk.Button(row, text="Resume", style="Tool.TButton", command=resume)
        self.resume.state(["disabled"])  # until a partial session is chosen
        self.resume.pack(side="left")
        Tip(self.resume, style, "Ctrl+R: take what a partial session lacks")
        self.compare = ttk.Button(row, text="Compare", style="Tool.TButton", command=compare)
        self.compare.pack(side="right")
        Tip(
            self.compare,
            style,
            "Ctrl+K: the light field of the result seen before beside this one's",
        )
        holder = ttk.Frame(self.body, style="Card.TFrame")
        holder.pack(fill="both", expand=True)
        self.tree = ttk.Treeview(
            holder, columns=("name", "state"), show="headings", selectmode="browse", height=3
        )
        self.tree.heading("name", text="NAME", anchor="w")
        self.tree.heading("state", text="STATE", anchor="w")
        self.tree.column("name", width=px(104), minwidth=px(50), stretch=True)
        self.tree.column("state", width=px(88), minwidth=px(50), stretch=False)
        bar = ttk.Scrollbar(holder, orient="vertical", command=self.tree.yview, takefocus=False)
        self.tree.configure(yscrollcommand=bar.set)
        bar.pack(side="right", fill="y")
        self.tree.pack(side="left", fill="both", expand=True)
        self.tree.bind("<<TreeviewSelect>>", self._select)

    @property
    def selected(self) -> Listed | None:
        """The session that is chosen."""
        chosen = self.tree.selection()
        return next((e for e in self.entries if chosen and str(e.path) == chosen[0]), None)

    def show(self, entries: list[Listed]) -> None:
        """Show the sessions there are; the choice stays."""
        if entries != self.entries:
            self.entries = entries
            self._fill()

    def choose(self, path: Path) -> None:
        """Choose a session without telling anybody."""
        if self.tree.exists(str(path)):
            self._last = path
            self.tree.selection_set(str(path))
            self.tree.focus(str(path))
            self.tree.see(str(path))

    def _to_list(self, _event: object) -> None:
        self.tree.focus_set()

    def _fill(self) -> None:
        wanted = self.filter.get().strip().lower()
        before = self.tree.selection()
        self.tree.delete(*self.tree.get_children())
        for entry in self.entries:
            word = word_of(entry)
            name = f"{entry.created[11:16]}  {entry.name}" if entry.created else entry.name
            if wanted and wanted not in f"{entry.path.parent.name} {name} {word}".lower():
                continue
            self.tree.insert("", "end", iid=str(entry.path), values=(name, word))
        if before and self.tree.exists(before[0]):
            self.tree.selection_set(before[0])

    def _select(self, _event: object) -> None:
        entry = self.selected
        self.resume.state(
            ["!disabled" if entry and word_of(entry).startswith(("◐", "!")) else "disabled"]
        )
        if entry is not None and entry.path != self._last:  # filling the list chooses it again
            self._last = entry.path
            self._chosen(entry)
