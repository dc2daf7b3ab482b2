"""Every driver as a case: how it is made, driven to its limits and unplugged.

Simulated and emulated devices pass the same tests, in real time. The V4L2 camera joins them inside
the virtual machine of ``make hardware-vm``, the USB3 camera and the USB trigger in the processes
that tests/hardware/test_under_umockdev.py starts.
"""

from __future__ import annotations

import gc
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from emulated.firmware import Box, compile_firmware
from emulated.gige_camera import GigeCamera
from emulated.needs import need, need_typelib
from emulated.x_server import XServer

from drivers.camera.genicam import GenicamCamera, GenicamSettings
from drivers.camera.simulated import Sensor, SimulatedCamera
from drivers.camera.v4l2 import V4l2Camera, V4l2Settings
from drivers.projector.protocol import ProjectorCapabilities
from drivers.projector.second_screen import ScreenProjector, ScreenSettings
from drivers.projector.simulated import SimulatedProjector
from drivers.simulation.faults import Fault, FaultScript
from drivers.simulation.world import World
from drivers.transport.x_display import lift_curtain
from drivers.trigger.serial import SerialTrigger
from drivers.trigger.simulated import SimulatedTrigger
from drivers.trigger.usb import UsbTrigger
from drivers.waiting import MonotonicClock

ROWS, COLS = 48, 64
SENSOR = Sensor(
    rows=ROWS,
    cols=COLS,
    bits=12,
    black_level_dn=16.0,
    white_level_dn=4095.0,
    gain_dn_per_e=0.28,
    read_noise_e=10.9,
    readout_s=0.01,
)
IN_VM = "LABRIG_VM_KERNEL" in os.environ
IN_UMOCKDEV = "umockdev" in os.environ.get("LD_PRELOAD", "")
if IN_UMOCKDEV:
    CAMERAS, TRIGGERS = ("usb3",), ("usb",)
else:
    CAMERAS = ("v4l2",) if IN_VM else ("simulated", "genicam")
    TRIGGERS = ("simulated", "serial")


@dataclass(frozen=True)
class Case:
    """One device under test: its numbers as the tests need them, and how to pull it out.

    ``exposures_s`` are two it can take, ``mode`` the one in which frames come; ``wrong_s`` is an
    exposure it must refuse.
    """

    device: Any
    unplug: Callable[[], object]
    slack_s: float = 0.0
    exposures_s: tuple[float, float] = (0.01, 0.02)
    wrong_s: float = 1000.0
    mode: str = "software"


def _steady_light(_image: Any, _black_level: float) -> Any:
    return np.full((ROWS, COLS), 1e4)


def world_with(*kinds: str) -> World:
    """Return a world in real time whose devices are lost when it is told ``unplug``."""
    faults = FaultScript(Fault(kind=kind, shot="unplug", times=1000) for kind in kinds)
    return World(
        light=_steady_light,
        clock=MonotonicClock(),
        faults=faults,
    )


def _gige(request: pytest.FixtureRequest) -> Case:
    need_typelib("Aravis", "0.8", package="gir1.2-aravis-0.8 python3-gi")
    camera = GigeCamera(f"BH{os.getpid()}")
    request.addfinalizer(camera.stop)
    settings = GenicamSettings(device=camera.serial, size=(COLS, ROWS))
    return Case(GenicamCamera(settings), camera.unplug)


def _usb3(request: pytest.FixtureRequest) -> Case:
    from emulated.u3v_camera import U3vCamera  # noqa: PLC0415 - only where umockdev is preloaded

    bus = request.getfixturevalue("_usb_bus")
    port = bus.plug(U3vCamera(lambda rows, cols: np.full((rows, cols), 10.0)))
    request.addfinalizer(lambda: bus.forget(port))
    return Case(GenicamCamera(GenicamSettings(device="U3V0001")), port.unplug)


@pytest.fixture(scope="session")
def _usb_bus() -> Any:
    from emulated.usb_umockdev import UsbBus  # noqa: PLC0415

    bus = UsbBus()
    yield bus
    bus.close()


def _vivid(request: pytest.FixtureRequest) -> Case:
    # loaded as tests/hardware/vm/guest/test_vivid.py wants it, if it did not do so before
    words = ["vivid", "n_devs=2", "num_inputs=1,1", "input_types=0x0,0x3", "node_types=0x1,0x1"]
    subprocess.run(["modprobe", "-d", os.environ["LABRIG_VM_KERNEL"], *words], check=True)
    subprocess.run(["udevadm", "settle", "-t", "20"], check=False)
    camera = V4l2Camera(V4l2Settings(device="/dev/video0", size=(320, 180), pixel_format="Y16"))
    camera.open()
    interval_s = camera.snapshot()["format"]["interval_s"]
    camera.close()

    def unplug() -> None:
        subprocess.run(["v4l2-ctl", "-d", "/dev/video0", "-c", "disconnect=1"], check=True)

    return Case(
        camera,
        unplug,
        slack_s=0.4,  # an emulated processor
        exposures_s=(interval_s, interval_s),
        mode="free-run",
    )


@pytest.fixture(params=CAMERAS)
def camera(request: pytest.FixtureRequest) -> Any:
    """Each camera, closed."""
    if request.param == "simulated":
        world = world_with("camera-lost")
        device = SimulatedCamera(SENSOR, world, seed=1)
        case = Case(device, lambda: world.faults.notice("unplug", ""))
    else:
        case = {"genicam": _gige, "usb3": _usb3, "v4l2": _vivid}[request.param](request)
    yield case
    case.device.close()
    gc.collect()  # a camera of Aravis that outlives the process takes it down with it


@pytest.fixture(scope="session")
def _server(tmp_path_factory: pytest.TempPathFactory) -> Any:
    server = XServer(tmp_path_factory.mktemp("behaviour"), right=(COLS, ROWS))
    yield server
    server.stop()


@pytest.fixture(params=["simulated", "screen"])
def projector(request: pytest.FixtureRequest) -> Any:
    """Each projector, closed."""
    if request.param == "simulated":
        world = world_with("projector-lost")
        can = ProjectorCapabilities(
            rows=ROWS, cols=COLS, refresh_hz=60.0, latency_s=(0.0, 0.02), settle_s=0.0
        )
        device: Any = SimulatedProjector(can, world, latency_s=0.0)
        case = Case(device, lambda: world.faults.notice("unplug", ""))
    else:
        server = request.getfixturevalue("_server")
        device = ScreenProjector(
            ScreenSettings(
                output="PROJ", rows=ROWS, cols=COLS, display=server.display, refresh_hz=60.0
            )
        )

        def kill_window() -> None:
            device._window._process.kill()

        case = Case(device, kill_window)
    yield case
    device.close()
    if request.param == "screen":
        lift_curtain(request.getfixturevalue("_server").display, "PROJ")


@pytest.fixture(scope="session")
def _firmware(tmp_path_factory: pytest.TempPathFactory) -> Any:
    need("g++", package="g++")
    return compile_firmware(tmp_path_factory.mktemp("firmware"))


@pytest.fixture(params=TRIGGERS)
def trigger(request: pytest.FixtureRequest) -> Any:
    """Each trigger, closed."""
    if request.param == "simulated":
        case = Case(SimulatedTrigger(world_with()), lambda: None)
    elif request.param == "usb":
        case = _usb_trigger(request)
    else:
        box = Box(request.getfixturevalue("_firmware"))
        request.addfinalizer(box.unplug)  # noqa: PT021 - only where there is one
        case = Case(SerialTrigger(box.port, boot_s=0.3), box.unplug)
    yield case
    case.device.close()


def _usb_trigger(request: pytest.FixtureRequest) -> Case:
    from emulated.usb_trigger import UsbTriggerDevice  # noqa: PLC0415

    bus = request.getfixturevalue("_usb_bus")
    emulated = UsbTriggerDevice(request.getfixturevalue("_firmware"))
    request.addfinalizer(emulated.stop)
    port = bus.plug(emulated)
    request.addfinalizer(lambda: bus.forget(port))
    return Case(UsbTrigger(), port.unplug)
