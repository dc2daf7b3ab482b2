"""All commands by name, each one call of the Python API; those that are called are imported."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module

import typer

PLACES = {
    "demo": "demo.demo",
    "check": "check.check",
    "capture": "capture.capture",
    "resume": "capture.resume",
    "verify": "capture.verify",
    "ls": "capture.ls",
    "analyse": "analyse.analyse",
    "report": "analyse.report",
    "series": "series.series",
    "solve": "solve.solve",
    "devices": "devices.devices",
    "doctor": "doctor.doctor",
    "schema": "schema.schema",
    "gui": "gui.gui",
    "import": "capture.import_",
    "simulate": "simulate.simulate_",
    "calibrate": "calibrate.app",
    "accuracy": "accuracy.app",
}


def app_of(names: Iterable[str]) -> typer.Typer:
    """Return the command line with these of its commands."""
    app = typer.Typer(
        name="labrig", add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False
    )
    app.callback()(_labrig)
    for name in names:
        module, attribute = PLACES[name].split(".")
        command = getattr(import_module(f"labrig.cli.{module}"), attribute)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name=name)(command)
    return app


def _labrig() -> None:
    """Measure how light travels in scattering media."""
