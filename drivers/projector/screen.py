"""The projector's window: a process of its own, with one Tk window exactly over one output.

Run by `drivers.projector.second_screen` as ``python -m drivers.projector.screen``. It obeys
messages on standard input and answers on standard output; when its input ends, so does it, and the
black curtain below its window comes to light.
"""

from __future__ import annotations

import hashlib
import os
import time
import tkinter as tk
from collections.abc import Callable
from typing import Any

from drivers.transport.messages import MessageReader, write_message
from drivers.transport.x_display import keep_screen_saver_off

GUARD_MS = 500


class Window:
    """Shows preloaded images pixel for pixel, above everything else on its output."""

    def __init__(self, x: int, y: int, width: int, height: int) -> None:
        self._size = (width, height)
        self._root = tk.Tk()
        self._root.withdraw()
        self._top = tk.Toplevel(self._root, bg="black", cursor="none")
        self._top.overrideredirect(True)
        self._top.geometry(f"{width}x{height}+{x}+{y}")
        self._label = tk.Label(self._top, bd=0, highlightthickness=0, padx=0, pady=0, bg="black")
        self._label.place(x=0, y=0, width=width, height=height)
        self._black = tk.PhotoImage(
            master=self._root, data=pgm(width, height, bytes(width * height))
        )
        self._images: list[tk.PhotoImage] = []
        self._obscured = False
        self._label.bind("<Visibility>", self._on_visibility)
        self.show(None)
        self._guard()

    def describe(self) -> dict[str, Any]:
        """Return what the window really is."""
        return {
            "x": self._top.winfo_rootx(),
            "y": self._top.winfo_rooty(),
            "width": self._label.winfo_width(),
            "height": self._label.winfo_height(),
            "depth": self._top.winfo_screendepth(),
            "visual": str(self._top.winfo_screenvisual()),
            "tk": str(self._root.tk.call("info", "patchlevel")),
        }

    def clear(self) -> None:
        """Forget the loaded images, black on the screen."""
        self.show(None)
        self._images.clear()

    def load(self, pixels: bytes) -> str:
        """Keep one image, rows one after the other; return the digest of its pixels."""
        width, height = self._size
        self._images.append(tk.PhotoImage(master=self._root, data=pgm(width, height, pixels)))
        return hashlib.sha256(pixels).hexdigest()

    def show(self, index: int | None) -> dict[str, Any]:
        """Show an image, None for black; return once the X server has drawn it."""
        image = self._black if index is None else self._images[index]
        begin_s = time.monotonic()
        self._label.configure(image=image)
        self._top.lift()
        self._top.update()
        self._top.winfo_pointerxy()  # asks the server, which answers when all before is drawn
        return {"begin_s": begin_s, "drawn_s": time.monotonic(), "obscured": self._obscured}

    def listen(self, obey: Callable[[], None]) -> None:
        """Call ``obey`` whenever standard input has bytes; return after `quit`."""
        self._root.tk.createfilehandler(0, tk.READABLE, lambda *_: obey())
        self._root.mainloop()

    def quit(self) -> None:
        """End `listen`."""
        self._root.tk.deletefilehandler(0)
        self._root.destroy()

    def _on_visibility(self, event: tk.Event[tk.Misc]) -> None:
        self._obscured = str(event.state) != "VisibilityUnobscured"

    def _guard(self) -> None:
        # Notifications and other windows that came on top would be measured as light.
        if self._obscured:
            self._top.lift()
        self._root.after(GUARD_MS, self._guard)


def pgm(width: int, height: int, pixels: bytes) -> bytes:
    """Return a grey image as Tk reads it; no pixel is touched on the way."""
    return b"P5\n%d %d\n255\n" % (width, height) + pixels


def main() -> None:
    """Serve one driver until its messages end."""
    # Only messages may go to the pipe, whatever a library prints.
    answers = os.dup(1)
    os.dup2(2, 1)
    reader = MessageReader(0)
    first = reader.read()
    if first is None:
        return
    keep_screen_saver_off(os.environ["DISPLAY"])
    geometry = first[0]
    window = Window(*(geometry[key] for key in ("x", "y", "width", "height")))
    write_message(answers, {"tag": geometry["tag"], **window.describe()})

    def obey() -> None:
        while True:
            received = reader.read()
            if received is None or received[0]["order"] == "quit":
                window.quit()
                return
            message, payload = received
            answer: dict[str, Any] = {"tag": message["tag"]}
            if message["order"] == "clear":
                window.clear()
            elif message["order"] == "load":
                answer["digest"] = window.load(payload)
            else:
                answer |= window.show(message["index"])
            write_message(answers, answer)
            if not reader.pending():
                return

    window.listen(obey)


if __name__ == "__main__":
    main()
