"""The window's side of the rig: asks through the door, shows what comes back."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from labrig.gui.metering import Metering
from labrig.gui.snaps import keep
from labrig.station.door import (
    Applied,
    Connected,
    Disconnected,
    Message,
    Planned,
    RunEnded,
    RunTold,
    Said,
    Show,
    Trouble,
    Working,
)
from labrig.station.meters import Roi
from labrig.station.starting import open_door

if TYPE_CHECKING:
    from labrig.gui.app import App

METER_S = 0.25  # between two readings of histogram and focus
SILENCE_S = 4.0  # without a picture and without a word of the station, which says so after two


class Devices:
    """Live view, exposure, plan and runs, as far as the window has a part in them."""

    def __init__(self, app: App) -> None:
        self._app = app
        self.rig: Connected | None = None
        self.plan: Planned | None = None
        self.applied: Applied | None = None
        self.run: RunTold | None = None
        self.running = False
        self.roi: Roi | None = None
        self.shows: Show = "stripes"
        self._read_s = self._told_s = 0.0
        self._seen_s = time.monotonic()
        self._working = Working(what="", done=0, total=0)
        self._drawer_before = ""
        self._silent = False
        self.metering = Metering(app, self)
        places = app.places
        self.door, self._thread = open_door(
            rig=places.rig, scene=places.scene, plan=places.plan, out=places.out
        )
        self._restore()
        app.say("info", f"opening rig {places.rig.name}")
        app.capture.able("no rig is connected yet")

    # What the operator asks.

    def expose(self, exposure_s: float, gain_db: float) -> None:
        """Set exposure and gain."""
        self.door.ask(lambda s: s.expose(exposure_s, gain_db))

    def show(self, what: Show) -> None:
        """Let the projector show something."""
        self.shows = what
        self._app.pattern.choose(what)
        self.door.ask(lambda s: s.show(what))
        if what == "cycle":
            self._app.live.decomposing.set(True)
            self.open_drawer("decomposition")

    def hold(self, *, paused: bool) -> None:
        """Hold the live picture, or let it go on."""
        self._app.live.paused.set(paused)
        self._seen_s = time.monotonic()
        self.door.ask(lambda s: s.hold(paused=paused))

    def set_roi(self, roi: Roi | None) -> None:
        """Let histogram and focus look at a part of the picture."""
        if roi is not None and self.rig is not None:
            rows, cols = self.rig.shape
            x, y = min(roi[0], cols - 8), min(roi[1], rows - 8)
            roi = (x, y, min(roi[2], cols - x), min(roi[3], rows - y))
        self.roi = roi
        self._app.camera.show_roi(roi)
        self._app.live.set_roi(roi)
        self._app.focus.reset_best()
        self._read_s = 0.0

    def change_plan(self, **changes: Any) -> None:
        """Change stripes or bracket of the plan."""
        self.door.ask(lambda s: s.change_plan(**changes))

    def open_drawer(self, what: str) -> None:
        """Open the profile, the live fit, the run, or nothing."""
        if what == "decomposition" and self.shows != "cycle" and not self.running:
            self.show("cycle")
        elif what != "decomposition" and self.shows == "cycle" and not self.running:
            self.show("stripes")
        self._app.live.drawer.show(what)

    def snap(self) -> None:
        """Keep the picture that is shown, in its raw counts."""
        picture = self._app.live.picture
        if picture is None:
            return
        self._app.say(*keep(picture, self._app.places.out / "snaps"))

    def capture(self) -> None:
        """Run the plan."""
        if self.rig is None or self.running or self.plan is None:
            return
        operator = self._app.settings.operator or None
        self._begin_run()
        self.door.ask(lambda s: s.capture(operator))

    def resume(self) -> None:
        """Go on with the session that is chosen."""
        entry = self._app.browser.selected
        if entry is None or self.running:
            return
        self._begin_run()
        self._app.say("info", f"resuming {entry.path.name}")
        self.door.ask(lambda s: s.resume(entry.path))

    def command(self, word: str) -> None:
        """Command the run."""
        self.door.command(word)

    def abort(self) -> bool:
        """Abort the run; False if none runs."""
        if self.running:
            self._app.say("warn", "abort asked")
            self.door.command("abort")
        return self.running

    # What comes back.

    def poll(self) -> None:
        """Take what came through the door; never waits."""
        while not self.door.told.empty():
            self._hear(self.door.told.get())
        app = self._app
        picture = app.live.take(self.door.pictures, visible=app.tab == 0)
        now = time.monotonic()
        if picture is not None:
            self._seen_s = now
            if self._silent:
                self._silent = False
                app.banner.hide()
            if now - self._read_s >= METER_S and not app.closed:
                self._read_s = now
                self.metering.take(picture)
        elif self.rig is not None and not (self.running or app.live.paused.get() or self._silent):
            patience_s = SILENCE_S + (self.applied.exposure_s if self.applied else 0.0)
            if now - self._seen_s > patience_s:
                self._tell_silence(now - self._seen_s)
        self.metering.poll()
        if now - self._told_s > METER_S:
            self._told_s = now
            app.live.say_rates(self.door.pictures.dropped)
            app.live.drawer.live.tell_age()
            self._say_status()

    def _hear(self, message: Message) -> None:
        app = self._app
        if isinstance(message, Said):
            app.say(message.level, message.text)
        elif isinstance(message, Working):
            self._working = message
        elif isinstance(message, Trouble):
            self._trouble(message)
        elif isinstance(message, Connected):
            self._connected(message)
        elif isinstance(message, Disconnected):
            self._disconnected(message)
        elif isinstance(message, Applied):
            self.applied = message
            app.camera.applied(message)
            if message.why:
                app.say("warn", message.why)
        elif isinstance(message, Planned):
            self._planned(message)
        elif isinstance(message, RunTold):
            self._follow(message)
        else:
            self._ended(message)

    def _trouble(self, trouble: Trouble) -> None:
        if not trouble.text:
            self._app.banner.hide()
            return
        text = f"{trouble.text[:1].upper()}{trouble.text[1:]} {trouble.safe}".strip()
        self._app.banner.show(text, [("Retry", self.retry)] if trouble.retry else [])
        self._app.say("error", trouble.text)

    def retry(self) -> None:
        """Open the devices again."""
        self._app.banner.hide()
        self._silent = False
        self._seen_s = time.monotonic()
        self._app.live.paused.set(False)
        self.door.ask(lambda s: s.recover())

    def _tell_silence(self, seconds: float) -> None:
        self._silent = True
        self._trouble(
            Trouble(
                text=f"No frame for {seconds:.1f} s, and the camera gives no reason.",
                safe="Check its cable and trigger. Nothing that was saved is lost.",
            )
        )

    def _connected(self, rig: Connected) -> None:
        app = self._app
        self.rig = rig
        self._seen_s = time.monotonic()
        app.live.connected(rig)
        app.camera.connected(rig)
        app.pattern.able(rig.can_show)
        app.lights["Camera"].configure(
            text=f"● {rig.camera.replace('labrig ', '')} · {rig.bits} bit", style="Ok.TLabel"
        )
        app.lights["Projector"].configure(
            text=f"● {rig.projector.replace('labrig ', '')}", style="Ok.TLabel"
        )
        app.name.configure(text=rig.name)
        about = ("simulated" if rig.simulated else "", app.settings.operator)
        app.about.configure(text=" · ".join(word for word in about if word))
        app.capture.able("")
        app.say(
            "info",
            f"{rig.camera}, {rig.shape[1]} x {rig.shape[0]}, {rig.bits} bit; "
            f"{rig.projector}, black shown",
        )
        app.judge(connected=True)

    def _disconnected(self, gone: Disconnected) -> None:
        app = self._app
        self.rig = None
        app.live.connected(None, gone.why)
        app.camera.connected(None)
        for name in ("Camera", "Projector"):
            app.lights[name].configure(text=f"✕ {name}", style="Bad.TLabel")
        app.capture.able("no rig is connected: Retry in the banner opens it again")
        app.judge(connected=False)

    def _planned(self, plan: Planned) -> None:
        app = self._app
        told = {v.text for v in self.plan.verdicts} if self.plan else set()
        self.plan = plan
        app.pattern.planned(plan)
        app.capture.planned(plan, self.metering.uncertainty)
        app.lights["Disk"].configure(
            text=f"● {plan.free_bytes / 1e9:.0f} GB free",
            style="Ok.TLabel" if plan.free_bytes > 4 * plan.n_bytes else "Bad.TLabel",
        )
        for verdict in plan.verdicts:
            if verdict.word != "ok" and verdict.text not in told:
                app.say("error" if verdict.word == "refused" else "warn", verdict.text)

    def _begin_run(self) -> None:
        app = self._app
        self.running, self.run = True, None
        self._drawer_before = app.live.drawer.open
        if self.plan is not None:
            app.live.drawer.run.begin(self.plan)
        app.live.drawer.show("run")
        app.live.paused.set(False)
        app.banner.hide()
        self._enable(on=False)
        app.judge(capturing=True)

    def _enable(self, *, on: bool) -> None:
        app = self._app
        app.camera.enable(on=on)
        app.pattern.enable(on=on)
        app.capture.able("" if on else "a run has the camera; Esc stops it")
        for name in ("pause", "profile", "fit live", "roi"):
            app.live.tools[name].state(["!disabled" if on else "disabled"])

    def _follow(self, told: RunTold) -> None:
        app = self._app
        before, self.run = self.run, told
        app.live.drawer.run.tell(told)
        if told.kind == "problem":
            app.say("warn", told.text)
        elif told.kind == "note":
            app.say("info", told.text)
        elif told.kind == "state":
            if told.state == "paused" and told.reason != "asked by the operator":
                app.banner.show(
                    f"The run stands still: {told.reason} {told.saved} of {told.total} frames "
                    "are safe.",
                    [
                        ("Go on", lambda: self._answer("resume")),
                        ("Skip group", lambda: self._answer("skip-group")),
                        ("Abort", lambda: self._answer("abort")),
                    ],
                )
            elif told.state in ("running", "finishing") and app.banner.text.startswith("The run"):
                app.banner.hide()
        if before is None or before.shot != told.shot:
            line = self.plan.patterns.get(told.shot) if self.plan else None
            app.pattern.preview(line)
        if told.kind in ("saved", "step"):
            app.live.drawer.run.redraw()

    def _answer(self, word: str) -> None:
        self._app.banner.hide()
        self.door.command(word)

    def _ended(self, ended: RunEnded) -> None:
        app = self._app
        self.running = False
        self._enable(on=True)
        app.live.drawer.show(self._drawer_before)
        self._seen_s = time.monotonic()
        word = {"completed": "info", "aborted": "warn"}.get(ended.state, "error")
        reason = f": {ended.reason}" if ended.reason else ""
        app.say(word, f"run {ended.state}{reason}")
        if ended.state in ("failed", "refused"):
            safe = "What was saved stays saved." if ended.session else "Nothing was begun."
            app.banner.show(f"The run {ended.state}{reason}. {safe}", [("Retry", self.retry)])
        app.judge(
            capturing=False,
            session="" if ended.session is None else ended.session.name,
            session_whole=ended.state == "completed",
            analysed=False,
            exported=False,
        )
        if ended.session is not None:
            app.name.configure(text=ended.session.name)
            app.outcomes.captured(ended.session, whole=ended.state == "completed")

    # Words at the foot, settings, and the end.

    def _say_status(self) -> None:
        app, run, working = self._app, self.run, self._working
        if self.running:
            if run is None:
                app.status.show("preparing the run", None, running=True)
                return
            step = f" · {run.step}" if run.step else ""
            left = f" · {run.eta_s:.0f} s left" if run.eta_s else ""
            app.status.show(
                f"{run.state} · {run.shot}{step} · {run.saved}/{run.total}{left}",
                run.saved / max(run.total, 1),
                running=True,
            )
        elif working.what:
            share = working.done / working.total if working.total else None
            app.status.show(working.what, share, running=False)
        elif not app.outcomes.say_status():
            plan = self.plan
            ready = (
                ""
                if plan is None or self.rig is None
                else (
                    f"Ready · F5 captures {sum(len(i) for _, i in plan.groups)} shots, about "
                    f"{sum(plan.seconds.values()):.0f} s"
                )
            )
            lost = "no rig is connected" if app.live.why_empty != "connecting" else "connecting"
            app.status.show(ready or lost, None, running=False)

    def remembered(self) -> dict[str, Any]:
        """Return what the settings keep of exposure and plan."""
        found: dict[str, Any] = {}
        if self.applied is not None:
            found |= {"exposure_s": self.applied.exposure_s, "gain_db": self.applied.gain_db}
        if self.plan is not None:
            found |= {
                "period_px": self.plan.period_px,
                "shifts": self.plan.shifts,
                "bracket_s": self.plan.bracket_s,
            }
        return found

    def _restore(self) -> None:
        kept = self._app.settings
        changes: dict[str, Any] = {}
        if kept.bracket_s:
            changes["bracket_s"] = kept.bracket_s
        if kept.period_px and kept.shifts:
            changes |= {"period_px": kept.period_px, "shifts": kept.shifts}
        if changes:
            self.door.ask(lambda s: s.change_plan(**changes))
        if kept.exposure_s:
            self.expose(kept.exposure_s, kept.gain_db)

    def close(self) -> None:
        """End what runs, make the rig dark, and wait for the thread."""
        self.door.command("abort")
        self.door.closing.set()
        self.metering.close()
        self._thread.join(15.0)
