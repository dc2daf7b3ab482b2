"""Small things that many panels use: cards, fields that commit, tips, rows of buttons."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from tkinter import ttk

from labrig.gui.style import Style

TIP_MS = 500


class Card(ttk.Frame):
    """A panel with a heading; what it holds goes into `body`."""

    def __init__(self, parent: tk.Misc, style: Style, heading: str = "") -> None:
        px = style.px
        super().__init__(parent, style="Card.TFrame", padding=(px(8), px(5), px(8), px(7)))
        self.heading = ttk.Label(self, text=heading.upper(), style="Head.TLabel")
        if heading:
            self.heading.pack(anchor="w", pady=(0, px(3)))
        self.body = ttk.Frame(self, style="Card.TFrame")
        self.body.pack(fill="both", expand=True)


class Tip:
    """A line that appears beside a widget under the pointer or with the keyboard's focus."""

    _open: tk.Toplevel | None = None

    def __init__(self, widget: tk.Misc, style: Style, text: str | Callable[[], str]) -> None:
        self._widget, self._style, self._text = widget, style, text
        self._after = ""
        for event in ("<Enter>", "<FocusIn>"):
            widget.bind(event, self._soon, add="+")
        for event in ("<Leave>", "<FocusOut>", "<ButtonPress>", "<Destroy>", "<KeyPress>"):
            widget.bind(event, self._hide, add="+")

    @property
    def text(self) -> str:
        """What it says now."""
        return self._text if isinstance(self._text, str) else self._text()

    def _soon(self, _event: object) -> None:
        self._hide()
        self._after = self._widget.after(TIP_MS, self._show)

    def _hide(self, _event: object = None) -> None:
        if self._after:
            self._widget.after_cancel(self._after)
            self._after = ""
        if Tip._open is not None:
            Tip._open.destroy()
            Tip._open = None

    def _show(self) -> None:
        self._after = ""
        if not self.text or not self._widget.winfo_ismapped():
            return
        p, px = self._style.palette, self._style.px
        tip = tk.Toplevel(self._widget, background=p.line, takefocus=False)
        tip.wm_overrideredirect(True)
        tk.Label(
            tip,
            text=self.text,
            background=p.field,
            foreground=p.text,
            justify="left",
            font=self._style.font("small"),
            padx=px(6),
            pady=px(3),
            wraplength=px(340),
        ).pack(padx=1, pady=1)
        tip.update_idletasks()
        x = min(self._widget.winfo_rootx(), tip.winfo_screenwidth() - tip.winfo_reqwidth())
        y = self._widget.winfo_rooty() + self._widget.winfo_height() + px(2)
        if y + tip.winfo_reqheight() > tip.winfo_screenheight():
            y = self._widget.winfo_rooty() - tip.winfo_reqheight() - px(2)
        tip.wm_geometry(f"+{max(x, 0)}+{y}")
        Tip._open = tip


class NumberField(ttk.Frame):
    """A labelled field that acts on Return, on leaving it and on its arrows, never on each key.

    What is no number, or is refused, is shown as such and goes back to what holds.
    """

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        *,
        label: str,
        unit: str = "",
        commit: Callable[[str], None],
        step: Callable[[str, int], str] | None = None,
        width: int = 8,
        label_width: int = 8,
    ) -> None:
        super().__init__(parent, style="Card.TFrame")
        px = style.px
        self.name = label
        self._commit = commit
        self._step = step
        self._held = ""
        self.value = tk.StringVar(self)
        ttk.Label(self, text=label, style="Card.TLabel", width=label_width).pack(side="left")
        if unit:
            ttk.Label(self, text=unit, style="CardDim.TLabel").pack(side="right", padx=(px(4), 0))
        kind = ttk.Spinbox if step else ttk.Entry
        self.entry = kind(self, textvariable=self.value, width=width, font=style.font())
        self.entry.pack(side="left", fill="x", expand=True)
        self.entry.bind("<Return>", self._done)
        self.entry.bind("<KP_Enter>", self._done)
        self.entry.bind("<FocusOut>", self._done)
        self.entry.bind("<Escape>", self._back)
        if step:
            self.entry.bind("<<Increment>>", lambda _e: self._by(+1))
            self.entry.bind("<<Decrement>>", lambda _e: self._by(-1))

    def hold(self, text: str) -> None:
        """Show what really holds; what is being typed is left alone."""
        typing = self.focus_get() is self.entry and self.value.get() != self._held
        self._held = text
        if not typing:
            self.value.set(text)
        self.entry.state(["!invalid"])

    def refuse(self) -> None:
        """Mark what was typed as refused, and go back to what holds."""
        self.value.set(self._held)
        self.entry.state(["invalid"])

    def enable(self, *, on: bool) -> None:
        """Let it be typed into, or not."""
        self.entry.state(["!disabled" if on else "disabled"])

    def _done(self, _event: object = None) -> None:
        if self.value.get() != self._held:
            self._commit(self.value.get())

    def _back(self, _event: object = None) -> str:
        self.value.set(self._held)
        return "break"

    def _by(self, sign: int) -> str:
        if self._step is not None:
            try:
                self._commit(self._step(self.value.get(), sign))
            except ValueError:
                self.refuse()
        return "break"


def tool(
    parent: tk.Misc, style: Style, text: str, key: str, act: Callable[[], None], tip: str = ""
) -> ttk.Button:
    """Return a button of a tool bar, its key in its name."""
    named = f"{text}  {key}" if key else text
    button = ttk.Button(parent, text=named, style="Tool.TButton", command=act)
    if tip:
        Tip(button, style, tip)
    return button


def toggle(
    parent: tk.Misc,
    style: Style,
    text: str,
    key: str,
    of: tk.BooleanVar,
    act: Callable[[], None],
    tip: str = "",
) -> ttk.Checkbutton:
    """Return a switch of a tool bar."""
    named = f"{text}  {key}" if key else text
    button = ttk.Checkbutton(
        parent, text=named, style="Toggle.Toolbutton", variable=of, command=act
    )
    if tip:
        Tip(button, style, tip)
    return button


def number(text: str) -> float:
    """Return a typed number, a comma for a point allowed; raise ValueError if it is none."""
    return float(text.strip().replace(",", "."))


def by_steps(text: str, sign: int) -> str:
    """Return a typed number a tenth larger or smaller, to three digits."""
    return f"{number(text) * (1.1 if sign > 0 else 1.0 / 1.1):.3g}"


def by_one(text: str, sign: int) -> str:
    """Return a typed whole number one larger or smaller."""
    return str(int(number(text)) + sign)
