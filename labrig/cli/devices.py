"""The command that lists what is plugged in."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from drivers.camera.genicam_library import genicam_cameras
from drivers.errors import DriverError
from drivers.transport.serial_line import serial_ports
from drivers.transport.usb_transfer import usb_devices
from drivers.transport.v4l2_device import video_devices
from drivers.transport.x_display import lift_curtain, outputs
from labrig.cli.say import AsJson, say, say_json
from labrig.real_devices import plugins


def devices(
    as_json: AsJson = False,
    uncover: Annotated[
        str | None, typer.Option(help="Give an output, left black, its desktop back.")
    ] = None,
) -> None:
    """List cameras, outputs and ports by the names that rig files take; nothing is switched."""
    display = os.environ.get("DISPLAY", "")
    if uncover is not None:
        lifted = lift_curtain(display, uncover)
        say(f"{uncover}: {'uncovered' if lifted else 'was not covered'}")
        return
    found = {
        "camera v4l2": [f"{path} ({info.card})" for path, info in video_devices()],
        "camera genicam": _genicam(),
        "projector screen": _outputs(display),
        "trigger serial": [f"{port.path} ({port.description})" for port in serial_ports()],
        "trigger usb": usb_devices(),
        "third party": plugins(),
    }
    if as_json:
        say_json(found)
        return
    for kind, names in found.items():
        for name in names or ["none"]:
            say(f"{kind:18}{name}")


def _genicam() -> list[str]:
    try:
        return [f"{serial} ({model})" for _, model, serial in genicam_cameras()]
    except DriverError as error:
        return [str(error)]


def _outputs(display: str) -> list[str]:
    try:
        return [f"{o.name} ({o.width}x{o.height} at +{o.x}+{o.y})" for o in outputs(display)]
    except DriverError as error:
        return [str(error)]
