"""All commands, each one call of the Python API."""

from __future__ import annotations

import typer

from labrig.cli.accuracy import app as accuracy
from labrig.cli.analyse import analyse, report
from labrig.cli.calibrate import app as calibrate
from labrig.cli.capture import capture, import_, ls, resume, verify
from labrig.cli.check import check
from labrig.cli.demo import demo
from labrig.cli.devices import devices
from labrig.cli.doctor import doctor
from labrig.cli.gui import gui
from labrig.cli.schema import schema
from labrig.cli.series import series
from labrig.cli.simulate import simulate_
from labrig.cli.solve import solve

app = typer.Typer(
    name="labrig",
    help="Measure how light travels in scattering media.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for command in (
    demo,
    check,
    capture,
    resume,
    verify,
    ls,
    analyse,
    report,
    series,
    solve,
    devices,
    doctor,
    schema,
    gui,
):
    app.command()(command)
app.command(name="import")(import_)
app.command(name="simulate")(simulate_)
app.add_typer(calibrate, name="calibrate")
app.add_typer(accuracy, name="accuracy")
