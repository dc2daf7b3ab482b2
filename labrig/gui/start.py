"""Opens the window: finds files, settings and a display, or says in one line what is missing."""

from __future__ import annotations

import tkinter as tk
from dataclasses import replace
from pathlib import Path

from labrig.errors import ConfigError
from labrig.exits import EXIT_BAD_INPUT
from labrig.folders import config_folder
from labrig.gui import settings as kept


def start(
    *,
    rig: Path | None = None,
    scene: Path | None = None,
    plan: Path | None = None,
    out: Path | None = None,
    operator: str | None = None,
    scale: int | None = None,
) -> int:
    """Open the window and stay until it is closed; return the exit code.

    What is not given is as it was last, else the simulated rig that comes with the program.

    Raises
    ------
    ConfigError
        If there is no display, or a file that was named is not there.
    """
    folder = config_folder()
    file = kept.settings_file()
    found, said = kept.load(file)
    if operator is not None:
        found = replace(found, operator=operator)

    def place(given: Path | None, before: str, usual: Path) -> Path:
        if given is not None and not given.is_file():
            msg = f"{given}: there is no such file; name one that is."
            raise ConfigError(msg)
        last = Path(before) if before else usual
        return given or (last if last.is_file() else usual)

    from labrig.gui.app import App, Places  # noqa: PLC0415 - not before the files are there

    places = Places(
        rig=place(rig, found.rig, folder / "rigs" / "simulated-live.yaml").absolute(),
        scene=place(scene, found.scene, folder / "scenes" / "dilute-milk.yaml").absolute(),
        plan=place(plan, found.plan, folder / "plans" / "six-shifts.yaml").absolute(),
        out=(out or Path(found.out)).absolute(),
        settings=file,
    )
    try:
        root = tk.Tk(className="labrig")
    except tk.TclError as error:
        msg = f"no window can be opened ({error}); set DISPLAY, or use labrig capture and analyse."
        raise ConfigError(msg) from error
    app = App(root, places, found, scale=None if scale is None else scale / 100.0)
    if said:
        app.say("warn", said)
    root.mainloop()
    return EXIT_BAD_INPUT if not app.closed else 0
