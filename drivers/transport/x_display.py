"""What an X display knows beyond Tk: named outputs, the screen saver, a window that outlives us.

By ctypes on libX11, libXrandr and libXss. Each call uses a connection of its own and closes it,
for an Xlib connection belongs to one thread.
"""

from __future__ import annotations

import ctypes as ct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

from drivers.errors import DeviceNotFoundError

CURTAIN = "_LABRIG_CURTAIN_"
_OVERRIDE_REDIRECT = 1 << 9
_CURSOR = 1 << 14
_RETAIN_PERMANENT = 1
_XA_WINDOW = 33


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """A named output: where it lies on the desktop, px, and how it is driven.

    ``refresh_hz`` is None where the server does not say; ``scaled`` if the server stretches the
    picture to the mode of the output.
    """

    name: str
    x: int
    y: int
    width: int
    height: int
    refresh_hz: float | None
    scaled: bool


class _Monitor(ct.Structure):
    _fields_ = [
        ("name", ct.c_ulong),
        ("primary", ct.c_int),
        ("automatic", ct.c_int),
        ("n_outputs", ct.c_int),
        ("x", ct.c_int),
        ("y", ct.c_int),
        ("width", ct.c_int),
        ("height", ct.c_int),
        ("width_mm", ct.c_int),
        ("height_mm", ct.c_int),
        ("outputs", ct.POINTER(ct.c_ulong)),
    ]


class _Mode(ct.Structure):
    _fields_ = [
        ("id", ct.c_ulong),
        ("width", ct.c_uint),
        ("height", ct.c_uint),
        ("dot_clock", ct.c_ulong),
        ("h_sync_start", ct.c_uint),
        ("h_sync_end", ct.c_uint),
        ("h_total", ct.c_uint),
        ("h_skew", ct.c_uint),
        ("v_sync_start", ct.c_uint),
        ("v_sync_end", ct.c_uint),
        ("v_total", ct.c_uint),
        ("name", ct.c_char_p),
        ("name_length", ct.c_uint),
        ("flags", ct.c_ulong),
    ]


class _Resources(ct.Structure):
    _fields_ = [
        ("timestamp", ct.c_ulong),
        ("config_timestamp", ct.c_ulong),
        ("n_crtc", ct.c_int),
        ("crtcs", ct.POINTER(ct.c_ulong)),
        ("n_output", ct.c_int),
        ("outputs", ct.POINTER(ct.c_ulong)),
        ("n_mode", ct.c_int),
        ("modes", ct.POINTER(_Mode)),
    ]


class _OutputInfo(ct.Structure):  # the first fields, all that is read
    _fields_ = [("timestamp", ct.c_ulong), ("crtc", ct.c_ulong)]


class _CrtcInfo(ct.Structure):  # the first fields, all that is read
    _fields_ = [
        ("timestamp", ct.c_ulong),
        ("x", ct.c_int),
        ("y", ct.c_int),
        ("width", ct.c_uint),
        ("height", ct.c_uint),
        ("mode", ct.c_ulong),
        ("rotation", ct.c_ushort),
    ]


class _WindowAttributes(ct.Structure):
    _fields_ = [
        ("background_pixmap", ct.c_ulong),
        ("background_pixel", ct.c_ulong),
        ("border_pixmap", ct.c_ulong),
        ("border_pixel", ct.c_ulong),
        ("bit_gravity", ct.c_int),
        ("win_gravity", ct.c_int),
        ("backing_store", ct.c_int),
        ("backing_planes", ct.c_ulong),
        ("backing_pixel", ct.c_ulong),
        ("save_under", ct.c_int),
        ("event_mask", ct.c_long),
        ("do_not_propagate_mask", ct.c_long),
        ("override_redirect", ct.c_int),
        ("colormap", ct.c_ulong),
        ("cursor", ct.c_ulong),
    ]


_DEAF = ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_void_p)(lambda _display, _error: 0)


@cache
def _library(name: str, package: str) -> ct.CDLL:
    try:
        return ct.CDLL(name)
    except OSError as error:
        msg = f"{name} is not installed; run: sudo apt-get install {package}"
        raise DeviceNotFoundError(msg) from error


@cache
def _x11() -> ct.CDLL:
    lib = _library("libX11.so.6", "libx11-6")
    display, window = ct.c_void_p, ct.c_ulong
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "XSetErrorHandler": (ct.c_void_p, [ct.c_void_p]),
        "XOpenDisplay": (display, [ct.c_char_p]),
        "XCloseDisplay": (ct.c_int, [display]),
        "XDefaultRootWindow": (window, [display]),
        "XDefaultScreen": (ct.c_int, [display]),
        "XBlackPixel": (ct.c_ulong, [display, ct.c_int]),
        "XGetAtomName": (ct.c_void_p, [display, ct.c_ulong]),
        "XInternAtom": (ct.c_ulong, [display, ct.c_char_p, ct.c_int]),
        "XGetSelectionOwner": (window, [display, ct.c_ulong]),
        "XFree": (ct.c_int, [ct.c_void_p]),
        "XSync": (ct.c_int, [display, ct.c_int]),
        "XCreateSimpleWindow": (
            window,
            [display, window, *[ct.c_int] * 2, *[ct.c_uint] * 3, *[ct.c_ulong] * 2],
        ),
        "XChangeWindowAttributes": (
            ct.c_int,
            [display, window, ct.c_ulong, ct.POINTER(_WindowAttributes)],
        ),
        "XCreateBitmapFromData": (
            ct.c_ulong,
            [display, window, ct.c_char_p, ct.c_uint, ct.c_uint],
        ),
        "XCreatePixmapCursor": (
            ct.c_ulong,
            [display, *[ct.c_ulong] * 2, *[ct.c_void_p] * 2, ct.c_uint, ct.c_uint],
        ),
        "XMapRaised": (ct.c_int, [display, window]),
        "XSetCloseDownMode": (ct.c_int, [display, ct.c_int]),
        "XKillClient": (ct.c_int, [display, window]),
        "XDeleteProperty": (ct.c_int, [display, window, ct.c_ulong]),
        "XChangeProperty": (
            ct.c_int,
            [display, window, *[ct.c_ulong] * 2, *[ct.c_int] * 2, ct.c_void_p, ct.c_int],
        ),
        "XGetWindowProperty": (
            ct.c_int,
            [display, window, ct.c_ulong, *[ct.c_long] * 2, ct.c_int, ct.c_ulong]
            + [ct.c_void_p] * 5,
        ),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib


@cache
def _randr() -> ct.CDLL:
    lib = _library("libXrandr.so.2", "libxrandr2")
    lib.XRRGetMonitors.restype = ct.POINTER(_Monitor)
    lib.XRRGetMonitors.argtypes = [ct.c_void_p, ct.c_ulong, ct.c_int, ct.POINTER(ct.c_int)]
    lib.XRRFreeMonitors.argtypes = [ct.c_void_p]
    lib.XRRGetScreenResourcesCurrent.restype = ct.POINTER(_Resources)
    lib.XRRGetScreenResourcesCurrent.argtypes = [ct.c_void_p, ct.c_ulong]
    lib.XRRFreeScreenResources.argtypes = [ct.c_void_p]
    lib.XRRGetOutputInfo.restype = ct.POINTER(_OutputInfo)
    lib.XRRGetCrtcInfo.restype = ct.POINTER(_CrtcInfo)
    for function in (lib.XRRGetOutputInfo, lib.XRRGetCrtcInfo):
        function.argtypes = [ct.c_void_p, ct.c_void_p, ct.c_ulong]
    lib.XRRFreeOutputInfo.argtypes = [ct.c_void_p]
    lib.XRRFreeCrtcInfo.argtypes = [ct.c_void_p]
    return lib


@contextmanager
def _connection(display: str) -> Iterator[Any]:
    handle = _x11().XOpenDisplay(display.encode())
    if not handle:
        msg = f"no X server answers at display {display!r}; set DISPLAY, or start the X session."
        raise DeviceNotFoundError(msg)
    try:
        yield handle
    finally:
        _x11().XCloseDisplay(handle)


def outputs(display: str) -> list[Output]:
    """Return the active outputs of a display.

    Raises
    ------
    DeviceNotFoundError
        If no X server answers there.
    """
    with _connection(display) as handle:
        root, n = _x11().XDefaultRootWindow(handle), ct.c_int()
        monitors = _randr().XRRGetMonitors(handle, root, 1, ct.byref(n))
        resources = _randr().XRRGetScreenResourcesCurrent(handle, root)
        found = [_describe(handle, resources, monitors[k]) for k in range(n.value)]
        _randr().XRRFreeScreenResources(resources)
        _randr().XRRFreeMonitors(monitors)
    return found


def _describe(handle: Any, resources: Any, monitor: _Monitor) -> Output:
    name = _x11().XGetAtomName(handle, monitor.name)
    text = ct.string_at(name).decode()
    _x11().XFree(name)
    refresh_hz, scaled = None, False
    if monitor.n_outputs > 0:
        info = _randr().XRRGetOutputInfo(handle, resources, monitor.outputs[0])
        # an output that is off has none, and to ask for that ends this process
        crtc = info[0].crtc and _randr().XRRGetCrtcInfo(handle, resources, info[0].crtc)
        modes = {m.id: m for m in resources[0].modes[: resources[0].n_mode]}
        mode = modes.get(crtc[0].mode) if crtc else None
        if mode is not None:
            total = mode.h_total * mode.v_total
            refresh_hz = mode.dot_clock / total if total and mode.dot_clock else None
            shown = {crtc[0].width, crtc[0].height}  # a rotated output has them swapped
            scaled = shown != {mode.width, mode.height}
        if crtc:
            _randr().XRRFreeCrtcInfo(crtc)
        _randr().XRRFreeOutputInfo(info)
    return Output(
        name=text,
        x=monitor.x,
        y=monitor.y,
        width=monitor.width,
        height=monitor.height,
        refresh_hz=refresh_hz,
        scaled=scaled,
    )


def has_compositor(display: str) -> bool:
    """Return whether a compositor redraws the screen: it may scale, blend and delay."""
    with _connection(display) as handle:
        screen = _x11().XDefaultScreen(handle)
        atom = _x11().XInternAtom(handle, b"_NET_WM_CM_S%d" % screen, 0)
        return bool(_x11().XGetSelectionOwner(handle, atom))


def keep_screen_saver_off(display: str) -> None:
    """Keep screen saver and power saving away for as long as this process lives.

    The server lets them come again when the connection that this opens goes with its process.
    """
    saver = _library("libXss.so.1", "libxss1")
    saver.XScreenSaverSuspend.argtypes = [ct.c_void_p, ct.c_int]
    handle = _x11().XOpenDisplay(display.encode())
    if not handle:
        msg = f"no X server answers at display {display!r}; set DISPLAY."
        raise DeviceNotFoundError(msg)
    saver.XScreenSaverSuspend(handle, 1)
    _x11().XSync(handle, 0)


def draw_curtain(display: str, output: Output) -> None:
    """Lay a black window over an output that stays when this program ends, however it ends.

    A program that dies leaves its pattern's window to be removed by the server, and what was
    below it comes to light: the desktop, or this.
    """
    lift_curtain(display, output.name)
    with _connection(display) as handle:
        x11 = _x11()
        root = x11.XDefaultRootWindow(handle)
        black = x11.XBlackPixel(handle, x11.XDefaultScreen(handle))
        window = x11.XCreateSimpleWindow(
            handle, root, output.x, output.y, output.width, output.height, 0, black, black
        )
        # A pointer that rests on the output would be light on the sample.
        empty, colour = x11.XCreateBitmapFromData(handle, root, b"\0", 1, 1), (ct.c_ubyte * 16)()
        cursor = x11.XCreatePixmapCursor(handle, empty, empty, colour, colour, 0, 0)
        attributes = _WindowAttributes(override_redirect=1, cursor=cursor)
        mask = _OVERRIDE_REDIRECT | _CURSOR
        x11.XChangeWindowAttributes(handle, window, mask, ct.byref(attributes))
        x11.XMapRaised(handle, window)
        atom = x11.XInternAtom(handle, (CURTAIN + output.name).encode(), 0)
        value = ct.c_ulong(window)
        x11.XChangeProperty(handle, root, atom, _XA_WINDOW, 32, 0, ct.byref(value), 1)
        x11.XSetCloseDownMode(handle, _RETAIN_PERMANENT)
        x11.XSync(handle, 0)


def lift_curtain(display: str, output_name: str) -> bool:
    """Remove the black window from an output, so that its desktop shows again; False if none."""
    with _connection(display) as handle:
        x11 = _x11()
        root = x11.XDefaultRootWindow(handle)
        atom = x11.XInternAtom(handle, (CURTAIN + output_name).encode(), 0)
        window = _window_of(handle, root, atom)
        if window is None:
            return False
        # Xlib ends the program at an error, such as a window that somebody else removed before us.
        before = x11.XSetErrorHandler(_DEAF)
        x11.XKillClient(handle, window)
        x11.XDeleteProperty(handle, root, atom)
        x11.XSync(handle, 0)
        x11.XSetErrorHandler(before)
    return True


def _window_of(handle: Any, root: int, atom: int) -> int | None:
    kind, form = ct.c_ulong(), ct.c_int()
    count, left, value = ct.c_ulong(), ct.c_ulong(), ct.c_void_p()
    places = [ct.byref(place) for place in (kind, form, count, left, value)]
    _x11().XGetWindowProperty(handle, root, atom, 0, 1, 0, _XA_WINDOW, *places)
    if not value.value or count.value != 1:
        return None
    window = ct.cast(value, ct.POINTER(ct.c_ulong))[0]
    _x11().XFree(value)
    return int(window)
