"""Pages of HTML that stand alone: their figures are part of them, and lie beside them as files."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from labrig.errors import RunError
from labrig.reporting import drawing


@dataclass(frozen=True, slots=True, kw_only=True)
class Plate:
    """A figure of the page, its picture as base64 text of a PNG."""

    name: str
    title: str
    caption: str
    png: str


def templates() -> Environment:
    """Return the templates; what a template names and is not given is an error."""
    return Environment(
        loader=PackageLoader("labrig.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def write_page(folder: Path, name: str, render: Callable[[Path], str]) -> Path:
    """Write a page into a folder and return it.

    Parameters
    ----------
    render : makes the page, given the folder for the files of its figures

    Raises
    ------
    RunError
        If the place cannot be written.
    """
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        page = folder / name
        page.write_text(render(folder / "figures"), encoding="utf-8")
    except OSError as error:
        reason = error.strerror or str(error)
        msg = f"{folder}: the page cannot be written ({reason}); name another place with --out."
        raise RunError(msg) from error
    return page


def plates(
    drawn: drawing.Drawn,
    captions: Mapping[str, tuple[str, str]],
    files: Path,
    suffix: str = "",
) -> list[Plate]:
    """Return figures for a page, each also saved as PNG and PDF below ``files``."""
    found = []
    for name, figure in drawn.items():
        png = base64.b64encode(drawing.save(figure, files / f"{name}{suffix}")).decode("ascii")
        title, caption = captions[name]
        found.append(Plate(name=name, title=title, caption=caption, png=png))
    return found
