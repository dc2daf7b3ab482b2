"""Colours of the window, dark and light, and how well they can be told apart."""

from __future__ import annotations

from dataclasses import dataclass

Look = tuple[str, tuple[float, ...], str]  # colour, dashes in px, marker


@dataclass(frozen=True, slots=True, kw_only=True)
class Palette:
    """One set of colours.

    Attributes
    ----------
    ground, card, field : behind everything, of a panel, of what is typed or drawn into
    line, raised : borders, buttons
    text, dim : words
    accent, on_accent, select, on_select : what is active, and words on it
    ok, warn, bad, on_bad : states; never without a symbol and a word
    curves : Okabe and Ito's colours in an order that suits the ground, each with dash and marker
    """

    name: str
    ground: str
    card: str
    field: str
    line: str
    raised: str
    text: str
    dim: str
    accent: str
    on_accent: str
    select: str
    on_select: str
    ok: str
    warn: str
    bad: str
    on_bad: str
    curves: tuple[Look, ...]

    @property
    def word_pairs(self) -> dict[str, tuple[str, str]]:
        """Every pair of word and ground that the window shows."""
        grounds = {"ground": self.ground, "card": self.card, "field": self.field}
        words = {
            "text": self.text,
            "dim": self.dim,
            "ok": self.ok,
            "warn": self.warn,
            "bad": self.bad,
        }
        return {
            **{f"{w} on {g}": (words[w], grounds[g]) for w in words for g in grounds},
            "text on button": (self.text, self.raised),
            "dim on button": (self.dim, self.raised),
            "bad on button": (self.bad, self.raised),
            "accent words": (self.on_accent, self.accent),
            "selection": (self.on_select, self.select),
            "banner": (self.on_bad, self.bad),
        }


_DASHES: tuple[tuple[float, ...], ...] = (
    (),
    (11.0, 4.0),
    (7.0, 3.0, 2.0, 3.0),
    (3.0, 3.5),
    (11.0, 3.0, 2.0, 3.0, 2.0, 3.0),
    (5.0, 3.0),
)
_MARKERS = ("o", "s", "^", "D", "v", "P")


def _looks(*colours: str) -> tuple[Look, ...]:
    return tuple(zip(colours, _DASHES, _MARKERS, strict=True))


DARK = Palette(
    name="dark",
    ground="#1d2126",
    card="#262b32",
    field="#15181c",
    line="#3d454f",
    raised="#343b45",
    text="#eceff2",
    dim="#a3adb8",
    accent="#56a5f0",
    on_accent="#08131f",
    select="#27588f",
    on_select="#ffffff",
    ok="#62cba6",
    warn="#ecc057",
    bad="#ff857c",
    on_bad="#2a0604",
    curves=_looks("#E69F00", "#56B4E9", "#009E73", "#F0E442", "#CC79A7", "#D55E00"),
)
LIGHT = Palette(
    name="light",
    ground="#eef0f3",
    card="#ffffff",
    field="#fbfcfd",
    line="#c3cad3",
    raised="#e6eaef",
    text="#14181d",
    dim="#4d5763",
    accent="#0a5cc2",
    on_accent="#ffffff",
    select="#cbe0f8",
    on_select="#0d1a28",
    ok="#00694b",
    warn="#7a4a00",
    bad="#b01f16",
    on_bad="#ffffff",
    curves=_looks("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"),
)
PALETTES = {"dark": DARK, "light": LIGHT}
ZEBRA = ((255, 40, 110), (255, 236, 60))  # red, green, blue of the two stripes over clipped pixels


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of ``#rrggbb``, 0 .. 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours by WCAG 2: 1 .. 21."""

    def luminance(colour: str) -> float:
        parts = (part / 255.0 for part in rgb(colour))
        r, g, b = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    bright, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)
