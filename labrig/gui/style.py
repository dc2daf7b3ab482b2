"""The look of every widget: ttk's clam in our own colours, sizes through one scale."""

from __future__ import annotations

import tkinter as tk
from dataclasses import dataclass
from tkinter import font as tkfont
from tkinter import ttk

from labrig.gui.palette import DARK, PALETTES, Palette

BASE_PX = 12  # of text at scale 1
SCALES = (0.75, 3.0)


def monitor_scale(root: tk.Misc) -> float:
    """Return how much larger than on a monitor of 96 dots per inch everything shall be."""
    found = root.winfo_fpixels("1i") / 96.0
    return min(max(round(found * 4.0) / 4.0, 1.0), SCALES[1])


@dataclass
class Style:
    """Colours, fonts and sizes of one window; `apply` sets them, also later on.

    Attributes
    ----------
    scale : of all sizes
    step : of the text alone, px at scale 1, by Ctrl + and -
    """

    root: tk.Tk
    scale: float = 1.0
    step: int = 0
    palette: Palette = DARK

    def __post_init__(self) -> None:
        self._fonts: dict[str, tkfont.Font] = {}

    def px(self, size: float) -> int:
        """Return a length of scale 1 as screen pixels."""
        return max(round(size * self.scale), 1)

    def font(self, name: str = "text") -> tkfont.Font:
        """Return a named font: text, small, bold, title, head, mono, number."""
        return self._fonts[name]

    def apply(self, theme: str | None = None) -> None:
        """Set colours, fonts and sizes of every widget there is and will be."""
        self.palette = PALETTES.get(theme or self.palette.name, DARK)
        self.root.tk.call("tk", "scaling", 96.0 / 72.0 * self.scale)
        self._set_fonts()
        style, p = ttk.Style(self.root), self.palette
        style.theme_use("clam")
        self._set_plain(style)
        self._set_fields(style)
        self._set_rest(style)
        self.root.configure(background=p.ground)
        self.root.option_add("*TCombobox*Listbox.background", p.field)
        self.root.option_add("*TCombobox*Listbox.foreground", p.text)
        self.root.option_add("*TCombobox*Listbox.selectBackground", p.select)
        self.root.option_add("*TCombobox*Listbox.selectForeground", p.on_select)
        self.root.option_add("*TCombobox*Listbox.font", self.font())

    def _set_fonts(self) -> None:
        size = self.px(BASE_PX + self.step)
        mono = (
            "DejaVu Sans Mono"
            if "DejaVu Sans Mono" in tkfont.families(self.root)
            else (tkfont.nametofont("TkFixedFont", self.root).actual("family"))
        )
        plain = tkfont.nametofont("TkDefaultFont", self.root).actual("family")
        wanted: dict[str, tuple[str, int, str]] = {
            "text": (plain, size, "normal"),
            "small": (plain, round(size * 0.92), "normal"),
            "bold": (plain, size, "bold"),
            "title": (plain, round(size * 1.25), "bold"),
            "head": (plain, round(size * 0.84), "bold"),
            "mono": (mono, round(size * 0.94), "normal"),
            "number": (plain, round(size * 1.5), "bold"),
        }
        for name, (family, px, weight) in wanted.items():
            if name not in self._fonts:
                self._fonts[name] = tkfont.Font(root=self.root, name=f"labrig-{name}", exists=False)
            self._fonts[name].configure(family=family, size=-px, weight=weight)  # type: ignore[arg-type]

    def _set_plain(self, style: ttk.Style) -> None:
        p, px = self.palette, self.px
        style.configure(
            ".",
            background=p.ground,
            foreground=p.text,
            font=self.font(),
            bordercolor=p.line,
            darkcolor=p.card,
            lightcolor=p.card,
            troughcolor=p.field,
            focuscolor=p.accent,
            selectbackground=p.select,
            selectforeground=p.on_select,
            insertcolor=p.text,
        )
        style.configure("TFrame", background=p.ground)
        for name, ground in (("Card", p.card), ("Field", p.field), ("Banner", p.bad)):
            style.configure(f"{name}.TFrame", background=ground)
        looks = {
            "TLabel": (p.ground, p.text, "text"),
            "Dim.TLabel": (p.ground, p.dim, "text"),
            "Title.TLabel": (p.ground, p.text, "title"),
            "Ok.TLabel": (p.ground, p.ok, "text"),
            "Bad.TLabel": (p.ground, p.bad, "text"),
            "Card.TLabel": (p.card, p.text, "text"),
            "CardDim.TLabel": (p.card, p.dim, "text"),
            "CardSmall.TLabel": (p.card, p.dim, "small"),
            "CardOk.TLabel": (p.card, p.ok, "text"),
            "CardWarn.TLabel": (p.card, p.warn, "text"),
            "CardBad.TLabel": (p.card, p.bad, "text"),
            "CardMono.TLabel": (p.card, p.text, "mono"),
            "CardBold.TLabel": (p.card, p.text, "bold"),
            "Number.TLabel": (p.card, p.text, "number"),
            "Head.TLabel": (p.card, p.dim, "head"),
            "Banner.TLabel": (p.bad, p.on_bad, "bold"),
            "BannerDim.TLabel": (p.bad, p.on_bad, "text"),
        }
        for name, (ground, text, of) in looks.items():
            style.configure(name, background=ground, foreground=text, font=self.font(of))
        button = {
            "background": p.raised,
            "foreground": p.text,
            "bordercolor": p.line,
            "lightcolor": p.raised,
            "darkcolor": p.raised,
            "focusthickness": px(1),
            "focuscolor": p.accent,
            "padding": (px(8), px(3)),
            "width": 0,
            "relief": "flat",
        }
        style.configure("TButton", **button)
        style.configure("Tool.TButton", **button | {"padding": (px(4), px(2))})
        style.configure("Bad.TButton", **button | {"foreground": p.bad})
        style.configure(
            "Step.TButton",
            **button
            | {
                "background": p.card,
                "lightcolor": p.card,
                "darkcolor": p.card,
                "bordercolor": p.card,
                "anchor": "w",
                "padding": (px(6), px(3)),
            },
        )
        style.configure("Done.Step.TButton", foreground=p.ok)
        style.configure(
            "Now.Step.TButton",
            foreground=p.on_select,
            background=p.select,
            lightcolor=p.select,
            darkcolor=p.select,
            bordercolor=p.select,
        )
        style.configure("Later.Step.TButton", foreground=p.dim)
        style.configure(
            "Main.TButton",
            **button
            | {
                "background": p.accent,
                "foreground": p.on_accent,
                "font": self.font("bold"),
                "lightcolor": p.accent,
                "darkcolor": p.accent,
                "bordercolor": p.accent,
                "padding": (px(8), px(6)),
                "focuscolor": p.on_accent,
            },
        )
        for name in ("TButton", "Tool.TButton", "Bad.TButton"):
            style.map(
                name,
                background=[("disabled", p.card), ("pressed", p.field), ("active", p.line)],
                foreground=[("disabled", p.dim)],
                bordercolor=[("focus", p.accent)],
                lightcolor=[("pressed", p.field), ("active", p.line)],
                darkcolor=[("pressed", p.field), ("active", p.line)],
            )
        hover = [("active", p.raised)]
        style.map(
            "Step.TButton",
            background=hover,
            lightcolor=hover,
            darkcolor=hover,
            bordercolor=[("focus", p.accent)],
        )
        now = [("active", p.select)]
        style.map(
            "Now.Step.TButton",
            background=now,
            lightcolor=now,
            darkcolor=now,
            bordercolor=[("focus", p.accent)],
        )
        style.map(
            "Main.TButton",
            background=[("disabled", p.raised), ("active", p.accent)],
            foreground=[("disabled", p.dim)],
            bordercolor=[("focus", p.text)],
            lightcolor=[("disabled", p.raised)],
            darkcolor=[("disabled", p.raised)],
        )
        on = [("selected", p.select)]
        style.configure("Toggle.Toolbutton", **button | {"padding": (px(4), px(2))})
        style.map(
            "Toggle.Toolbutton",
            background=[*on, ("active", p.line)],
            foreground=[("selected", p.on_select), ("disabled", p.dim)],
            lightcolor=on,
            darkcolor=on,
            bordercolor=[("focus", p.accent), *on],
        )

    def _set_fields(self, style: ttk.Style) -> None:
        p, px = self.palette, self.px
        field = {
            "fieldbackground": p.field,
            "foreground": p.text,
            "bordercolor": p.line,
            "lightcolor": p.field,
            "darkcolor": p.field,
            "insertcolor": p.text,
            "arrowcolor": p.text,
            "background": p.raised,
            "padding": (px(4), px(2)),
        }
        for name in ("TEntry", "TSpinbox", "TCombobox"):
            extra = {
                "TEntry": {},
                "TSpinbox": {"arrowsize": px(9)},
                "TCombobox": {"arrowsize": px(13)},
            }[name]
            style.configure(name, **field | extra)
            style.map(
                name,
                bordercolor=[("invalid", p.bad), ("focus", p.accent)],
                lightcolor=[("invalid", p.bad), ("focus", p.accent)],
                fieldbackground=[("disabled", p.card), ("readonly", p.field)],
                foreground=[("disabled", p.dim)],
                arrowcolor=[("disabled", p.dim)],
                background=[("active", p.line), ("readonly", p.raised)],
                selectbackground=[("focus", p.select), ("!focus", p.field)],
                selectforeground=[("focus", p.on_select), ("!focus", p.text)],
            )
        style.configure(
            "TCheckbutton",
            background=p.card,
            foreground=p.text,
            indicatorbackground=p.field,
            indicatorforeground=p.text,
            upperbordercolor=p.dim,
            lowerbordercolor=p.dim,
            indicatorsize=px(11),
            indicatormargin=px(3),
            padding=px(1),
        )
        style.map(
            "TCheckbutton",
            background=[("active", p.card)],
            indicatorbackground=[("selected", p.accent), ("active", p.field)],
            indicatorforeground=[("selected", p.on_accent)],
            foreground=[("disabled", p.dim)],
        )

    def _set_rest(self, style: ttk.Style) -> None:
        p, px = self.palette, self.px
        style.configure(
            "TNotebook",
            background=p.ground,
            bordercolor=p.line,
            lightcolor=p.ground,
            darkcolor=p.ground,
            tabmargins=(0, px(2), 0, 0),
        )
        style.configure(
            "TNotebook.Tab",
            background=p.ground,
            foreground=p.dim,
            bordercolor=p.ground,
            lightcolor=p.ground,
            darkcolor=p.ground,
            padding=(px(11), px(4)),
            font=self.font(),
        )
        style.map(
            "TNotebook.Tab",
            background=[("selected", p.card), ("active", p.raised)],
            foreground=[("selected", p.text), ("active", p.text)],
            lightcolor=[("selected", p.card)],
            darkcolor=[("selected", p.card)],
            bordercolor=[("selected", p.line)],
            padding=[("selected", (px(11), px(4)))],
            expand=[("selected", (0, 0, 0, 0))],
            font=[("selected", self.font("bold"))],
        )
        style.configure(
            "Treeview",
            background=p.field,
            fieldbackground=p.field,
            foreground=p.text,
            bordercolor=p.line,
            lightcolor=p.field,
            darkcolor=p.field,
            rowheight=self.font().metrics("linespace") + px(5),
            font=self.font(),
        )
        style.map(
            "Treeview",
            background=[("selected", p.select)],
            foreground=[("selected", p.on_select)],
            bordercolor=[("focus", p.accent)],
        )
        style.configure(
            "Treeview.Heading",
            background=p.card,
            foreground=p.dim,
            font=self.font("head"),
            bordercolor=p.card,
            lightcolor=p.card,
            darkcolor=p.card,
            relief="flat",
            padding=(px(4), px(3)),
        )
        style.map("Treeview.Heading", background=[("active", p.raised)])
        style.configure(
            "TProgressbar",
            background=p.accent,
            troughcolor=p.field,
            bordercolor=p.line,
            lightcolor=p.accent,
            darkcolor=p.accent,
            thickness=px(10),
        )
        style.configure(
            "TScale",
            background=p.raised,
            troughcolor=p.field,
            bordercolor=p.line,
            lightcolor=p.raised,
            darkcolor=p.raised,
            gripcount=0,
            sliderlength=px(18),
            arrowsize=px(12),
        )
        style.map(
            "TScale",
            background=[("disabled", p.card), ("focus", p.accent), ("active", p.line)],
            lightcolor=[("focus", p.accent)],
            darkcolor=[("focus", p.accent)],
        )
        style.configure(
            "TScrollbar",
            background=p.raised,
            troughcolor=p.card,
            bordercolor=p.card,
            lightcolor=p.raised,
            darkcolor=p.raised,
            arrowcolor=p.dim,
            gripcount=0,
            arrowsize=px(10),
        )
        style.map("TScrollbar", background=[("active", p.line), ("disabled", p.card)])
        style.configure("TSeparator", background=p.line)
