"""Readings of the live picture, and what follows from them: exposure, focus, profile, live fit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from labrig.gui.helper import Helper
from labrig.station.door import Connected, Picture, Show
from labrig.station.meters import (
    GOOD,
    Meter,
    bracket_fits,
    bracket_from,
    fitting_exposure,
    profile_along,
    read,
)
from labrig.station.shown import Fitted

if TYPE_CHECKING:
    from labrig.gui.app import App
    from labrig.gui.devices import Devices

ROUNDS = 8  # of automatic exposure
ALWAYS = (0.6, 0.92)  # of full scale, between which continuous exposure lets be
DARK_HINT = 0.99  # share of dark pixels at which the picture is said to be black


class Metering:
    """What the window reads off the pictures that come."""

    def __init__(self, app: App, devices: Devices) -> None:
        self._app, self._devices = app, devices
        self.meter: Meter | None = None
        self.uncertainty = math.nan
        self._focused_s = 0.0
        self._auto = 0
        self._auto_back: Show | None = None
        self._hinted = False
        self._fitter: Helper | None = None

    def auto_expose(self) -> None:
        """Find the exposure under white light, and a bracket from it."""
        devices = self._devices
        if devices.rig is None or devices.running:
            return
        self._auto = ROUNDS
        self._auto_back = devices.shows
        devices.show("white")
        self._app.say("info", "automatic exposure under white light")

    def poll(self) -> None:
        """Give the newest set of stripes to the helper, take what it found."""
        if self._fitter is not None:
            self._fitter.poll()
        self._fit()

    def close(self) -> None:
        """End the helper."""
        if self._fitter is not None:
            self._fitter.stop()

    def take(self, picture: Picture) -> None:
        """Read a picture."""
        rig, app = self._devices.rig, self._app
        if rig is None:
            return
        roi = self._devices.roi
        meter = read(picture.pixels, black=rig.black_level, white=rig.white_level, roi=roi)
        self.meter = meter
        app.histogram.show(meter)
        if self._devices.running:
            return
        if picture.shows == "stripes":  # white light has few edges: it would pass for blur
            if picture.exposure_s != self._focused_s:  # noise would pass for sharpness
                app.focus.reset_best()
            self._focused_s = picture.exposure_s
            app.focus.read(meter.focus)
        if not self._auto and self._devices.plan is not None:
            app.pattern.preview(self._line_of(picture.shows))
        bracket = self._devices.plan.bracket_s if self._devices.plan else ()
        fits, why = app.day.exposure_fits, app.day.exposure_why
        if picture.shows not in ("black", "off"):
            fits, why = bracket_fits(
                meter, picture.exposure_s, bracket, black=rig.black_level, white=rig.white_level
            )
        app.judge(
            focus_share=app.focus.share,
            focus_readings=app.focus.readings,
            exposure_fits=fits,
            exposure_why=why,
        )
        self._hint(meter, picture)
        self._expose_by(meter, picture, rig)
        if app.live.drawer.open == "profile":
            self._profile(picture, rig)

    def _line_of(self, shows: str) -> np.ndarray[Any, Any] | None:
        """Return what the projector shows in the live view, one line of it."""
        lines = list(self._devices.plan.patterns.values()) if self._devices.plan else []
        size = lines[0].size if lines else 720
        if shows == "white":
            return np.full(size, 255, np.uint8)
        if shows == "black":
            return np.zeros(size, np.uint8)
        if shows == "off" or not lines:
            return None
        k = int(shows.rsplit(maxsplit=1)[-1]) if shows.startswith("shift") else 0
        return lines[min(k, len(lines) - 1)]

    def _hint(self, meter: Meter, picture: Picture) -> None:
        black = meter.dark > DARK_HINT and picture.shows not in ("black", "off")
        if black and not self._hinted:
            self._app.say(
                "warn",
                f"nearly every pixel is below 1 % at "
                f"{1e3 * picture.exposure_s:.3g} ms: raise the exposure (A)",
            )
        self._hinted = black

    def _expose_by(self, meter: Meter, picture: Picture, rig: Connected) -> None:
        """Take the next round of automatic exposure."""
        always = self._app.camera.continuous.get() and not self._auto
        if not (self._auto or always) or picture.exposure_s != self._exposure_held:
            return
        if self._auto and picture.shows != "white":
            return
        wanted = fitting_exposure(
            meter,
            picture.exposure_s,
            black=rig.black_level,
            white=rig.white_level,
            limits_s=rig.exposure_range_s,
        )
        wanted = float(f"{wanted:.3g}")
        if always:
            if not ALWAYS[0] <= meter.bright <= ALWAYS[1]:
                self._devices.expose(wanted, picture.gain_db)
            return
        self._auto -= 1
        good = GOOD[0] <= meter.bright <= GOOD[1] or wanted == picture.exposure_s
        if not (good or self._auto == 0):
            self._devices.expose(wanted, picture.gain_db)
            return
        self._auto = 0
        word = "info" if good else "warn"
        self._app.say(
            word,
            f"exposure {1e3 * picture.exposure_s:.4g} ms: the brightest pixels "
            f"stand at {100 * meter.bright:.0f} % of full scale",
        )
        self._devices.change_plan(bracket_s=bracket_from(picture.exposure_s, rig.exposure_range_s))
        if self._auto_back is not None:
            self._devices.show(self._auto_back)

    @property
    def _exposure_held(self) -> float:
        return self._devices.applied.exposure_s if self._devices.applied else 0.0

    def _profile(self, picture: Picture, rig: Connected) -> None:
        rows, cols = rig.shape
        region = rig.region_px or (0, 0, cols, rows)
        first, last = region[1], region[1] + region[3]
        if rig.beam_rows_px is not None:
            first, last = (round(r) for r in rig.beam_rows_px)
        line = profile_along(picture.pixels, (first, last), region, lit_side=rig.lit_side)
        unit, scale = ("mm", rig.mm_per_px) if rig.mm_per_px else ("px", 1.0)
        depth = (np.arange(line.size) + 0.5) * (scale or 1.0)
        self._app.live.drawer.profile(depth, line, rig.black_level, unit)

    # The live fit.

    def _fit(self) -> None:
        """Give the newest set of stripes to the helper, if it has nothing to do."""
        if self._app.live.drawer.open != "decomposition" or self._devices.running:
            return
        if self._fitter is None:
            self._fitter = Helper("live-fit")
            self._fitter.ask("warm", then=lambda _done: None)
        if self._fitter.busy:
            return
        found = self._devices.door.stripes.take()
        if found is not None:
            before = self._app.live.drawer.live.fitted
            self._fitter.ask("decompose", found, before, then=self._fitted, failed=self._not_fitted)

    def _fitted(self, fitted: Fitted) -> None:
        self._app.live.drawer.live.show(fitted)
        if math.isfinite(fitted.plan_std):
            self.uncertainty = fitted.plan_std
            if self._devices.plan is not None:
                self._app.capture.planned(self._devices.plan, self.uncertainty)

    def _not_fitted(self, why: str) -> None:
        self._app.say("warn", f"live fit: {why}")
