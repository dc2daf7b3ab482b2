"""Capture media A to D in layers, analyse them, and print the tables of docs/slab.md.

Heights of 2 and 5 mm, surfaces of index 1 and 1.33, stripes of 1.8 and 0.9 mm: 32 captures, whose
light is that of the Monte Carlo in three dimensions. With ``--noise N`` the light of one layer
is captured N times with other noise of the camera instead, and the scatter of the answers is set
beside what is stated. What was found is kept in FOLDER, so that a stopped run goes on.

    .venv/bin/python docs/examples/captures_of_layers.py FOLDER [MEDIA] [--noise N]
"""

import argparse
import json
import sys
import tempfile
from itertools import product
from pathlib import Path

import numpy as np
from bias_of_a_plane import MEDIA, prepared, say

import labrig
from analysis.slab_fit import SlabFit
from labrig.config import parse
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.session import Session
from labrig.steps.corrections import gather, shone
from labrig.steps.decay import attenuate
from labrig.steps.linearise import linearise
from labrig.steps.rectify import rectify
from labrig.steps.separation import separate
from labrig.steps.slab import fit_layer

HEIGHTS_MM, INDICES, PERIODS_PX = (2.0, 5.0), (1.0, 1.33), (12, 6)
MM_PER_PX = 0.15  # of the projector on the tank
NAMES = ("sigma_t_per_mm", "sigma_s_per_mm", "g")
OF_NOISE = (5.0, 1.33, 12)


def found(name: str, layer: tuple[float, float, int], folder: Path, seed: int = 1) -> dict:
    """Return what a capture's layer is found to be, from the folder if it was made before."""
    height_mm, index, period_px = layer
    kept = folder / f"{name}-{height_mm:g}-{index:g}-{period_px}-{seed}.json"
    if not kept.is_file():
        plan, rig, scene = prepared(name, height_mm, index, period_px=period_px, seed=seed)
        with tempfile.TemporaryDirectory() as place:
            with labrig.open_rig(rig, scene, plan) as opened:
                session = labrig.capture(plan, opened, Path(place))
            fit = fitted(session)
        values = (fit.sigma_t_per_mm, fit.sigma_s_per_mm, fit.g)
        of_noise, of_model = np.diag(fit.covariance), np.diag(fit.model_covariance)
        told = {"chi2_per_dof": fit.chi2_per_dof}
        for k, key in enumerate(NAMES):
            told[key] = [values[k], float(np.sqrt(of_noise[k])), float(np.sqrt(of_model[k]))]
        kept.write_text(json.dumps(told))
    return dict(json.loads(kept.read_text()))


def fitted(path: Path) -> SlabFit:
    """Return the fit of a layer that ``labrig analyse`` makes, without the plane beside it."""
    session, config = (
        Session.open(path),
        parse({"schema": "labrig-analysis/1"}, Analysis, source=""),
    )
    setup = parse(session.header["setup"], Setup, source=str(path))
    setup, known = shone(setup, gather(session, setup, config))
    pictures = rectify(linearise(session, setup, known), session, setup, known)
    decay = attenuate(separate(pictures, setup, config, known), pictures, setup, config)
    layer = fit_layer(pictures, setup, config, decay, None)
    if layer is None or layer.fit is None:
        sys.exit(f"no fit of a layer: {None if layer is None else layer.notes}")
    return layer.fit


def row(name: str, layer: tuple[float, float, int], told: dict) -> str:
    """Return a line of the table: deviations from the truth, and what is stated of them."""
    sigma_t, albedo, true_g = MEDIA[name][:3]
    cells = []
    for key, true in zip(NAMES, (sigma_t, albedo * sigma_t, true_g), strict=True):
        of, std = told[key][0], np.hypot(*told[key][1:])
        if key == "g":
            cells.append(f"{of - true:+.4f} ({std:.4f})")
        else:
            cells.append(f"{100 * (of / true - 1):+.2f} % ({100 * std / true:.2f})")
    height_mm, index, period_px = layer
    at = f"{name} | {height_mm:g} | {index:g} | {period_px * MM_PER_PX:g}"
    return f"| {at} | {' | '.join(cells)} | {told['chi2_per_dof'] ** 0.5:.1f} |"


def scatter(name: str, n: int, folder: Path) -> str:
    """Return a line of the table of noise: scatter over the std that is stated."""
    runs = [found(name, OF_NOISE, folder, seed) for seed in range(1, n + 1)]
    value, stated = (np.array([[run[key][k] for key in NAMES] for run in runs]) for k in (0, 1))
    seen = value.std(axis=0, ddof=1)
    ratio = seen / np.sqrt((stated**2).mean(axis=0))
    share = 100 * seen[:2] / value.mean(axis=0)[:2]
    scatters = f"{share[0]:.4f} % | {share[1]:.4f} % | {seen[2]:.5f}"
    return f"| {name} | {n} | {scatters} | {' | '.join(f'{one:.2f}' for one in ratio)} |"


def main() -> None:
    """Print one of the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("media", nargs="?", default="ABCD")
    parser.add_argument("--noise", type=int, default=0)
    told = parser.parse_args()
    told.folder.mkdir(parents=True, exist_ok=True)
    if told.noise:
        say("| medium | captures | sigma_t | sigma_s | g | over stated: sigma_t | sigma_s | g |")
        say("| --- | --- | --- | --- | --- | --- | --- | --- |")
        for name in told.media:
            say(scatter(name, told.noise, told.folder))
        return
    say("| medium | height | index | stripes | sigma_t | sigma_s | g | misfit |")
    say("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name in told.media:
        if name not in MEDIA:
            sys.exit(f"medium {name}: choose of {', '.join(MEDIA)}.")
        for layer in product(HEIGHTS_MM, INDICES, PERIODS_PX):
            say(row(name, layer, found(name, layer, told.folder)))


if __name__ == "__main__":
    main()
