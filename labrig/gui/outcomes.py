"""The window's side of sessions and results: analysis, tabs, comparison, price, export."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labrig.gui.helper import Helper
from labrig.station.shown import Bounces, Listed, Price, Shown

if TYPE_CHECKING:
    from labrig.gui.app import App

LIST_S = 3.0  # between two looks at the data root
WARM_S = 0.5  # after the window has shown
STAGES = ("linearise", "rectify", "separate", "attenuate", "stripes", "bounces", "invert", "write")
WORDS = {
    "linearise": "merging the bracket",
    "rectify": "cutting out the tank",
    "separate": "separating single and multiple",
    "attenuate": "fitting σₜ",
    "stripes": "fitting stripes and white light together",
    "bounces": "solving the bounces",
    "invert": "fitting σₛ and g",
    "write": "writing",
}


class Outcomes:
    """What was captured and what was made of it."""

    def __init__(self, app: App) -> None:
        self._app = app
        self.shown: Shown | None = None
        self._before: Shown | None = None
        self.weighted: Bounces | None = None
        self.own: Bounces | None = None
        self._doing = ""
        self._stage = ""
        self._helper: Helper | None = None
        self._begun_s = time.monotonic()
        self._listed_s = 0.0
        self._drawn: set[int] = set()
        self._priced: float | None = None
        self._newest: Path | None = None
        self._asking = False
        self._listing = False
        self.exported: list[Path] = []

    @property
    def busy(self) -> bool:
        """Whether something long is being done."""
        return bool(self._doing)

    def poll(self) -> None:
        """Take what the helper brought; look for new sessions now and then."""
        now = time.monotonic()
        if self._helper is None:
            if now - self._begun_s > WARM_S:
                self._helper = Helper("analysis")
                self._helper.ask("warm", then=lambda _done: None)
            return
        self._helper.poll()
        if now - self._listed_s > LIST_S and not (self._listing or self.busy):
            self._listed_s = now
            self._listing = True
            self._helper.ask(
                "listed", self._app.places.out, then=self._listed, failed=self._not_listed
            )
        if self._priced is not None and not self._asking:
            self._ask_price()

    def captured(self, session: Path, *, whole: bool) -> None:
        """Take a session that a run has left; a whole one is analysed at once."""
        self._listed_s = 0.0
        self._newest = session
        if whole:
            self.analyse(session)
        else:
            self._say_tabs("This session is partial: Ctrl+R takes what it lacks.")

    def open(self, entry: Listed) -> None:
        """Show a session's results, or say what it lacks."""
        app = self._app
        app.name.configure(text=entry.path.name)
        app.judge(
            session=entry.path.name,
            session_whole=entry.state == "completed",
            analysed=False,
            exported=False,
        )
        if entry.fitted:
            self._ask("reading the results", "shown", entry.path, then=self.show)
        elif entry.state == "completed":
            self._say_tabs("This session is not analysed yet: F7 analyses it.")
        else:
            self._say_tabs(
                f"This session is partial, {entry.saved} of {entry.planned} frames: Ctrl+R takes "
                "what it lacks."
            )

    def analyse(self, session: Path | None = None) -> None:
        """Analyse a session, or the one that is chosen."""
        entry = self._app.browser.selected
        path = session or (entry.path if entry is not None else None)
        if path is None or self.busy:
            return
        self._app.judge(analysing=True, analysed=False)
        self._say_tabs("analysing …")
        self._app.say("info", f"analysing {path.name}")
        self._ask("analysing", "analyse", path, then=self._analysed)

    def abort(self) -> None:
        """Stop the analysis by ending its process; a new one takes its place."""
        if not self.busy or self._helper is None:
            return
        doing, self._doing, self._stage = self._doing, "", ""
        self._helper.restart()
        self._asking = self._listing = False
        self._app.say("warn", f"{doing}: aborted")
        self._app.judge(analysing=False)
        if self.shown is None:
            self._say_tabs("The analysis was aborted: F7 begins it again.")
        else:
            self.show(self.shown)

    def compare(self) -> None:
        """Show the light field of the result seen before beside that of the chosen one."""
        if self.shown is None or self._before is None:
            self._app.say("warn", "look at two results, one after the other, to compare them")
            return
        self._app.show_tab(4)
        self._app.field.compare(self._before)

    # What is shown.

    def show(self, shown: Shown) -> None:
        """Show a result in every tab; the one in sight first."""
        self._leave(shown)
        self.shown = shown
        self.own = self.weighted = shown.bounces
        self._drawn.clear()
        app = self._app
        app.judge(analysed=True, analysing=False, exported=False)
        app.name.configure(text=shown.title)
        self.show_tab(app.tab)

    def show_tab(self, number: int) -> None:
        """Draw a tab of results when it is first looked at."""
        if number == 0 or self.shown is None or number in self._drawn:
            return
        tab = self._app.result_tabs[number - 1]
        self._drawn.add(number)
        tab.show(self.shown)
        weighted, own = self.weighted, self.own
        if weighted is None or own is None or weighted is self.shown.bounces:
            return
        if number == 3:
            self._app.bounces.show_weighted(weighted)
        elif number == 4:
            light = own if weighted is own else own.weighted(weighted.sigma_s)
            self._app.field.take(light, self.shown.title)

    def reweight(self, sigma_s: float) -> None:
        """Weight every bounce for another sigma_s (Eq. 11)."""
        if self.own is None or self.shown is None:
            return
        own = self.own
        self.weighted = own if sigma_s == own.sigma_s else own.weighted(sigma_s, light=False)
        self._app.bounces.show_weighted(self.weighted)
        self._drawn.discard(4)  # its many radiances are weighted when they are looked at

    def price(self, tolerance: float) -> None:
        """Ask what bounces to a tolerance would cost; the last question counts."""
        self._priced = tolerance

    def pay(self, tolerance: float) -> None:
        """Solve the bounces anew to a tolerance."""
        if self.shown is None or self.busy:
            return
        self._app.say("info", f"solving the bounces to {100 * tolerance:.2g} %")
        self._ask(
            "solving the bounces",
            "resolve",
            self.shown.path,
            tolerance=tolerance,
            then=self._resolved,
        )

    def export(self, kinds: tuple[str, ...] = ("png", "pdf", "csv", "nc")) -> None:
        """Write figures, curves and fields into a folder named after the session."""
        shown = self.shown
        if shown is None or self.busy:
            self._app.say("warn", "there is no result to export yet")
            return
        out = self._app.places.out / "exports" / shown.title
        self._app.report.done.configure(text="exporting …")
        self._ask("exporting", "export", shown.path, out, kinds=kinds, then=self._exported)

    def write_page(self) -> None:
        """Write the report as one HTML page."""
        shown = self.shown
        if shown is None or self.busy:
            return
        out = self._app.places.out / "exports" / shown.title
        self._ask("writing the report", "page", shown.path, out, then=self._exported)

    def say_status(self) -> bool:
        """Say what is being done at the foot of the window; False if nothing is."""
        if not self.busy:
            return False
        share = None
        text = self._doing
        if self._stage in STAGES:
            share = STAGES.index(self._stage) / len(STAGES)
            text += f" · {WORDS[self._stage]}"
        self._app.status.show(text, share, running=True)
        return True

    def close(self) -> None:
        """End the helper."""
        if self._helper is not None:
            self._helper.stop()

    # How it is done.

    def _ask(self, doing: str, job: str, *arguments: Any, then: Any, **options: Any) -> None:
        if self._helper is None:
            self._helper = Helper("analysis")
        self._doing, self._stage = doing, ""

        def done(value: Any) -> None:
            self._doing = self._stage = ""
            then(value)

        def failed(why: str) -> None:
            self._doing = self._stage = ""
            self._app.judge(analysing=False)
            self._app.say("error", f"{doing}: {why}")
            if job in ("analyse", "shown"):
                self._say_tabs(why)
            self._app.report.done.configure(text="")
            if self._app.devices.running:
                return  # the banner is the run's; the log has it
            self._app.banner.show(
                f"{doing[:1].upper()}{doing[1:]} failed: {why}",
                [("Retry", lambda: self._again(doing, job, arguments, then, options))],
            )

        self._helper.ask(job, *arguments, then=done, failed=failed, progress=self._at, **options)

    def _again(
        self, doing: str, job: str, arguments: Any, then: Any, options: dict[str, Any]
    ) -> None:
        self._app.banner.hide()
        self._ask(doing, job, *arguments, then=then, **options)

    def _at(self, stage: str) -> None:
        self._stage = stage

    def _analysed(self, shown: Shown) -> None:
        self._app.say(
            "info",
            f"analysed {shown.title}: "
            + ", ".join(f"{row.name} {row.value} {row.unit}".strip() for row in shown.rows[:2]),
        )
        for warning in shown.warnings:
            self._app.say("warn", warning)
        self._listed_s = 0.0
        self.show(shown)

    def _resolved(self, bounces: Bounces) -> None:
        self.own = self.weighted = bounces
        self._app.bounces.take(bounces)
        if self.shown is not None and 4 in self._drawn:
            self._app.field.take(bounces, self.shown.title)
        self._app.say("info", "the bounces are shown to the wanted accuracy")

    def _exported(self, written: list[Path]) -> None:
        self.exported = written
        where = written[0].parent if written else ""
        self._app.report.done.configure(text=f"✓ {len(written)} files in {where}")
        self._app.say("info", f"exported {len(written)} files to {where}")
        self._app.judge(exported=True)

    def _listed(self, entries: list[Listed]) -> None:
        self._listing = False
        app = self._app
        app.browser.show(entries)
        newest = self._newest
        if newest is not None and any(entry.path == newest for entry in entries):
            self._newest = None
            app.browser.choose(newest)

    def _not_listed(self, why: str) -> None:
        self._listing = False
        self._app.say("warn", f"sessions: {why}")

    def _ask_price(self) -> None:
        tolerance, self._priced = self._priced, None
        if self.shown is None or self._helper is None or tolerance is None:
            return
        self._asking = True

        def told(prices: list[Price]) -> None:
            self._asking = False
            self._app.bounces.say_prices(prices)

        def refused(why: str) -> None:
            self._asking = False
            self._app.bounces.price_words.configure(text="no price: see the log")
            self._app.say("warn", f"price of accuracy: {why}")

        self._helper.ask("prices", self.shown.path, tolerance=tolerance, then=told, failed=refused)

    def _leave(self, by: Shown | None) -> None:
        """Keep what was shown, to be compared with what takes its place."""
        if self.shown is not None and (by is None or by.path != self.shown.path):
            self._before = self.shown

    def _say_tabs(self, text: str) -> None:
        self._leave(None)
        self.shown = self.own = self.weighted = None
        for tab in self._app.result_tabs:
            tab.say(text)
