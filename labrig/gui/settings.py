"""What the window remembers from one day to the next: one JSON file."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

TABS = ("live", "separation", "attenuation", "bounces", "field", "report")


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Everything that is restored; what a device must take is read back by who sets it."""

    theme: str = "dark"
    scale_percent: int = 0
    text_step: int = 0
    width: int = 0
    height: int = 0
    tab: str = "live"
    log_open: str = "yes"
    colours: str = "cividis"
    rig: str = ""
    scene: str = ""
    plan: str = ""
    out: str = "sessions"
    operator: str = ""
    exposure_s: float = 0.0
    gain_db: float = 0.0
    period_px: int = 0
    shifts: int = 0
    bracket_s: tuple[float, ...] = field(default=())


def settings_file() -> Path:
    """Return where the settings are kept."""
    given = os.environ.get("LABRIG_SETTINGS")
    if given:
        return Path(given)
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "labrig" / "window.json"


def load(path: Path) -> tuple[Settings, str]:
    """Return the settings, and what must be said of them: a broken file gives the defaults.

    A single value that cannot be, is left at its default and named.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return Settings(), ""
    except (OSError, ValueError) as error:
        text = " ".join(str(error).split())
        return Settings(), f"the settings {path} cannot be read ({text}); the defaults hold."
    if not isinstance(content, dict):
        return Settings(), f"the settings {path} are no table of values; the defaults hold."
    found, wrong = Settings(), []
    for name in (f.name for f in fields(Settings)):
        if name in content:
            value = _fit(content[name], getattr(found, name), name)
            if value is None:
                wrong.append(name)
            else:
                found = replace(found, **{name: value})
    said = f"the settings {path} hold no usable {', '.join(wrong)}; the default holds."
    return found, said if wrong else ""


def save(path: Path, settings: Settings) -> str:
    """Keep the settings, whole or not at all; return why not, else nothing."""
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(asdict(settings), indent=2) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        return f"the settings cannot be kept in {path} ({error.strerror or error})."
    return ""


def _fit(value: Any, default: Any, name: str) -> Any:
    """Return a value in the type and range of its setting; None if it has no such value."""
    if isinstance(default, tuple):
        usable = isinstance(value, list) and all(_is_number(v) and v > 0 for v in value)
        return tuple(float(v) for v in value) if usable else None
    if isinstance(default, float):
        return float(value) if _is_number(value) and 0.0 <= value < 1e4 else None
    if isinstance(default, int):
        inside = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 20000
        if name == "scale_percent":
            inside = inside and (value == 0 or 75 <= value <= 300)
        return value if inside else None
    allowed = {
        "theme": ("dark", "light"),
        "tab": TABS,
        "colours": ("cividis", "grey"),
        "log_open": ("yes", "no"),
    }
    if not isinstance(value, str) or value not in allowed.get(name, (value,)):
        return None
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
