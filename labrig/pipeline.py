"""From a session to its results: the straight way of the data, a line a step."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from labrig.config import parse
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.results import Result, results_of, write_results, written
from labrig.session import Session
from labrig.steps.bounces import explain, render_bounces
from labrig.steps.corrections import gather, shone
from labrig.steps.decay import attenuate
from labrig.steps.joint import fit_joint
from labrig.steps.linearise import linearise
from labrig.steps.record import Outcome, run_of
from labrig.steps.record_fields import fields_of
from labrig.steps.rectify import rectify
from labrig.steps.remainder import remainder
from labrig.steps.separation import separate
from labrig.steps.slab import fit_layer
from labrig.steps.slab_picture import as_layer

Until = Literal["separation", "results"]


class Stopwatch:
    """Seconds by stage, told to whoever follows the progress."""

    def __init__(self, follow: Callable[[str], None] | None) -> None:
        self.seconds: dict[str, float] = {}
        self._follow = follow
        self._begun_s = time.perf_counter()
        self._stage = ""

    def start(self, stage: str) -> None:
        """End the stage before and begin one."""
        now_s = time.perf_counter()
        if self._stage:
            self.seconds[self._stage] = round(now_s - self._begun_s, 4)
        self._stage, self._begun_s = stage, now_s
        if self._follow is not None:
            self._follow(stage)


def analyse(
    session_path: Path,
    config: Analysis | None = None,
    *,
    until: Until = "results",
    out: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Analyse a session; the results are also written to disk.

    Parameters
    ----------
    until : "separation" stops there, for samples that are no scattering tank
    out : folder for the results; else ``results/`` in the session
    progress : called with the name of each stage as it begins

    Raises
    ------
    SessionError, CalibrationError, AnalysisError, AnalysisRefusedError
        Where no trustworthy answer exists; the message says why.
    """
    watch = Stopwatch(progress)
    config = config or Analysis.model_validate({"schema": "labrig-analysis/1"})
    session = Session.open(session_path)
    parent = out or results_of(session_path)
    setup = parse(session.header.get("setup"), Setup, source=f"{session_path}: setup")
    setup, known = shone(setup, gather(session, setup, config))
    decay = joint = layer = explained = left = None

    watch.start("linearise")
    radiances = linearise(session, setup, known)
    watch.start("rectify")
    pictures = rectify(radiances, session, setup, known)
    watch.start("separate")
    separated = separate(pictures, setup, config, known)
    if until == "results":
        watch.start("attenuate")
        decay = attenuate(separated, pictures, setup, config)
        watch.start("stripes")
        joint = fit_joint(pictures, setup, config, decay)
        layer = fit_layer(pictures, setup, config, decay, joint)
        watch.start("bounces")
        table = render_bounces(decay, pictures, config)
        watch.start("invert")
        explained = explain(separated, decay, table, pictures, joint.medium)
        left = remainder(pictures, setup, decay, joint, explained.grid)
        explained, left = as_layer(layer, explained, left, decay, config)
    watch.start("write")
    outcome = Outcome(
        session=session,
        setup=setup,
        known=known,
        config=config,
        pictures=pictures,
        separated=separated,
        decay=decay,
        joint=joint,
        layer=layer,
        explained=explained,
        remainder=left,
        seconds=watch.seconds,
    )
    fields, attributes = fields_of(outcome)
    return written(write_results(parent, run_of(outcome), fields, attributes), fields, attributes)
