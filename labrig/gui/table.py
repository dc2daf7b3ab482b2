"""The numbers of a result beside its pictures: values, truth, quality and warnings."""

from __future__ import annotations

import tkinter as tk
from tkinter import ttk

from labrig.gui.style import Style
from labrig.station.shown import Shown


class Numbers(ttk.Frame):
    """The table of parameters, and what must be known of them."""

    def __init__(self, parent: tk.Misc, style: Style, *, quality: bool = False) -> None:
        super().__init__(parent, style="Card.TFrame")
        self._style, self._quality = style, quality
        self.text = tk.Text(
            self,
            wrap="word",
            borderwidth=0,
            highlightthickness=1,
            state="disabled",
            takefocus=True,
            padx=style.px(8),
            pady=style.px(6),
            width=20,
            height=4,
            cursor="arrow",
        )
        bar = ttk.Scrollbar(self, orient="vertical", command=self.text.yview, takefocus=False)
        self.text.configure(yscrollcommand=bar.set)
        bar.pack(side="right", fill="y")
        self.text.pack(fill="both", expand=True)
        self.shown: Shown | None = None
        self.recolour()

    def recolour(self) -> None:
        """Take the colours of the palette."""
        p, font, text, px = self._style.palette, self._style.font, self.text, self._style.px
        text.configure(
            background=p.card,
            foreground=p.text,
            font=font(),
            highlightbackground=p.card,
            highlightcolor=p.accent,
            selectbackground=p.select,
            selectforeground=p.on_select,
        )
        text.tag_configure(
            "head", font=font("head"), foreground=p.dim, spacing1=px(8), spacing3=px(2)
        )
        text.tag_configure("name", foreground=p.dim, font=font("small"), spacing1=px(4))
        for tag in ("row", "plain"):
            text.tag_configure(tag, spacing1=px(3))
        text.tag_configure("value", font=font("bold"))
        text.tag_configure("dim", foreground=p.dim, font=font("small"))
        text.tag_configure(
            "warn", foreground=p.warn, font=font("small"), spacing1=px(2), lmargin2=px(12)
        )

    def show(self, shown: Shown) -> None:
        """Show the numbers of a result."""
        self.shown = shown
        text = self.text
        if self._quality:
            self._set_tabs(shown)
        text.configure(state="normal")
        text.delete("1.0", "end")
        text.insert("end", shown.title + "\n", "dim")
        if shown.rows:
            text.insert("end", "PARAMETERS\n", "head")
        for row in shown.rows:
            self._row(row.name, row.value, row.unit, row.truth, row.off)
        if self._quality and shown.quality:
            text.insert("end", "QUALITY\n", "head")
            for name, value in shown.quality:
                text.insert("end", f"{name}\t{value}\n", "plain")
        if shown.warnings:
            text.insert("end", "TO KNOW\n", "head")
            for warning in shown.warnings:
                text.insert("end", f"! {warning}\n", "warn")
        if self._quality and shown.seconds:
            text.insert("end", "TIME\n", "head")
            parts = (f"{stage} {s:.1f} s" for stage, s in shown.seconds.items())
            text.insert("end", " · ".join(parts) + "\n", "dim")
        text.configure(state="disabled")

    def _set_tabs(self, shown: Shown) -> None:
        """Let values begin behind the longest name, and truths behind the longest value."""
        font, px = self._style.font, self._style.px

        def widest(words: list[str], of: str = "text") -> int:
            return max((font(of).measure(word) for word in words), default=0) + px(16)

        names = widest([row.name for row in shown.rows])
        values = names + widest([f"{row.value} {row.unit}" for row in shown.rows], "bold")
        self.text.tag_configure("row", tabs=(names, values), lmargin2=values)
        first = widest([name for name, _ in shown.quality])
        self.text.tag_configure("plain", tabs=(first,), lmargin2=first)

    def _row(self, name: str, value: str, unit: str, truth: str, off: str) -> None:
        text = self.text
        if self._quality:
            known = truth not in ("", "—") and off not in ("", "—")
            text.insert("end", f"{name}\t", "row")
            text.insert("end", value, ("row", "value"))
            about = f" {unit}\t" + (f"truth {truth} ({off})" if known else "")
            text.insert("end", about, ("row", "dim"))
            text.insert("end", "\n")
            return
        text.insert("end", f"{name}\n", "name")
        text.insert("end", value, "value")
        text.insert("end", f" {unit}\n", "dim")
        if truth not in ("", "—") and off not in ("", "—"):
            text.insert("end", f"truth {truth}, off {off}\n", "dim")
