"""Starts the thread that owns the devices; loads what it needs there, while the window shows."""

from __future__ import annotations

import threading
from typing import Any

from labrig.station.door import Door


def open_door(**options: Any) -> tuple[Door, threading.Thread]:
    """Start the thread that owns the devices, and return the door to it.

    ``options`` are those of `labrig.station.station.Station`.
    """
    door = Door()

    def work() -> None:
        from labrig.station.station import Station  # noqa: PLC0415 - takes seconds

        Station(door, **options).run()

    thread = threading.Thread(target=work, name="labrig-station", daemon=False)
    thread.start()
    return door, thread
