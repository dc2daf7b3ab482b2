"""What a user would take instead, beside labrig: `make bench-peers`.

The problem is one that all can state: a layer of optical depth 10, albedo 0.9, g = 0.7, lit
straight by a unit flux; wanted is the scattered fluence at five depths, all bounces together.
labrig gives every bounce of it by itself. The truth is PythonicDISORT with 64 streams.

Each peer lives in an environment of its own below ``build/peers``, away from labrig's; one that
cannot be installed or run is said to be so. This file is run there once more with the peer's name.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
import venv
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DEPTH, ALBEDO, G = 10.0, 0.9, 0.7
PLACES = np.array([0.2, 0.5, 1.0, 3.0, 6.0])  # optical depths
N_BOUNCES = 120
WIDE = 400.0  # mean free paths: nothing is seen of the sides
PHOTONS, SAMPLES, CELL = 2000, 4096, 0.2
PEERS = ("PythonicDISORT", "mitsuba", "pytissueoptics", "pmcxcl")
BY_CHANCE = PEERS[1:]  # their error falls with the root of the time


def pythonic_disort() -> np.ndarray:
    """Discrete ordinates in three dimensions, 64 streams."""
    from PythonicDISORT.pydisort import pydisort

    streams = 64
    moments = G ** np.arange(streams)
    solved = pydisort(np.array([DEPTH]), np.array([ALBEDO]), streams, moments[None], 1.0, 1.0, 0.0)
    half = np.polynomial.legendre.leggauss(streams // 2)[1] / 2.0
    return 2.0 * np.pi * (np.concatenate([half, half]) @ solved[3](PLACES))


def mitsuba() -> np.ndarray:
    """Path tracing; fluence from the radiance along 16 directions at each depth."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    mu, weight = np.polynomial.legendre.leggauss(16)

    def radiance(depth: float, cosine: float) -> float:
        sensor = {
            "type": "radiancemeter",
            "origin": [0, 0, depth],
            "direction": [math.sqrt(1.0 - cosine**2), 0, -cosine],
            "medium": {"type": "ref", "id": "liquid"},
            "film": {"type": "hdrfilm", "width": 1, "height": 1, "pixel_format": "luminance",
                     "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": SAMPLES},
        }  # fmt: skip
        liquid = {"type": "homogeneous", "id": "liquid", "albedo": ALBEDO, "sigma_t": 1.0,
                  "phase": {"type": "hg", "g": G}}  # fmt: skip
        place = mi.ScalarTransform4f().translate([0, 0, DEPTH / 2]).scale([WIDE, WIDE, DEPTH / 2])
        scene = {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": -1, "rr_depth": 50},
            "liquid": liquid,
            "sun": {"type": "directional", "direction": [0, 0, 1], "irradiance": 1.0},
            "layer": {"type": "cube", "to_world": place, "bsdf": {"type": "null"},
                      "interior": {"type": "ref", "id": "liquid"}},
            "sensor": sensor,
        }  # fmt: skip
        return float(np.array(mi.render(mi.load_dict(scene)))[0, 0, 0])

    return np.array(
        [2.0 * np.pi * weight @ [radiance(float(x), float(m)) for m in mu] for x in PLACES]
    )


def pytissueoptics() -> np.ndarray:
    """Monte Carlo in Python; fluence from what is absorbed in layers around each depth."""
    import pytissueoptics as pto

    liquid = pto.ScatteringMaterial(mu_s=ALBEDO, mu_a=1.0 - ALBEDO, g=G, n=1.0)
    layer = pto.Cuboid(WIDE, WIDE, DEPTH, position=pto.Vector(0, 0, DEPTH / 2), material=liquid)
    scene = pto.ScatteringScene([layer])
    logger = pto.EnergyLogger(scene, views=[])
    source = pto.PencilPointSource(
        position=pto.Vector(0, 0, -1),
        direction=pto.Vector(0, 0, 1),
        N=PHOTONS,
        useHardwareAcceleration=False,
    )
    source.propagate(scene, logger=logger, showProgress=False)
    points = np.asarray(logger.getRawDataPoints())
    edges = np.stack([PLACES - CELL / 2, PLACES + CELL / 2])
    inside = (points[:, 3] >= edges[0][:, None]) & (points[:, 3] < edges[1][:, None])
    whole = (inside * points[:, 0]).sum(axis=1) / (PHOTONS * (1.0 - ALBEDO) * CELL)
    beam = np.exp(-PLACES) * math.sinh(CELL / 2) / (CELL / 2)
    return np.asarray(whole - beam)


def pmcxcl() -> np.ndarray:
    """Monte Carlo by OpenCL; fluence in the middle of a wide volume of voxels."""
    import pmcxcl as mcx

    side, per = 60, 5  # voxels across, and to a mean free path
    found = mcx.run(
        {
            "nphoton": 10_000_000,
            "vol": np.ones((side, side, int(DEPTH * per)), np.uint8),
            "prop": [[0, 0, 1, 1], [(1.0 - ALBEDO) / per, ALBEDO / per, G, 1.0]],
            "tstart": 0.0,
            "tend": 5e-9,
            "tstep": 5e-9,
            "srctype": "planar",
            "srcpos": [0, 0, 0],
            "srcparam1": [side, 0, 0, 0],
            "srcparam2": [0, side, 0, 0],
            "srcdir": [0, 0, 1],
            "bc": "ccrcca",
            "issrcfrom0": 1,
        }
    )
    column = np.asarray(found["flux"]).reshape(side, side, -1).mean(axis=(0, 1)) * 5e-9
    column *= side**2
    middle = (np.arange(column.size) + 0.5) / per
    return np.interp(PLACES, middle, column) - np.exp(-PLACES)


def labrig_slab() -> np.ndarray:
    """labrig in three dimensions: 120 bounces one by one, of a layer without an end sideways."""
    from dataclasses import replace

    from scipy.interpolate import CubicSpline

    from analysis.medium import Medium, Slab
    from analysis.transport.slab import solve_slab
    from analysis.transport.slab_resolution import depths, directions

    medium = Medium(sigma_t_per_mm=1.0, sigma_s_per_mm=1.0, g=G)
    slab = Slab(depth_mm=DEPTH, height_mm=1e6)
    at = depths(1.0, replace(slab, height_mm=5.0), fineness=1.5)
    grid = directions(G, slab, at, wavenumber_per_mm=0.0, fineness=1.3)
    field = solve_slab(medium, slab, replace(grid, n_z=2), n_bounces=N_BOUNCES)
    orders = field.fluence * ALBEDO ** np.arange(N_BOUNCES)[:, None] * np.exp(-field.x_mm)
    return np.asarray(CubicSpline(field.x_mm, orders[1:].sum(axis=0))(PLACES))


RUNS: dict[str, Callable[[], np.ndarray]] = {
    "PythonicDISORT": pythonic_disort,
    "mitsuba": mitsuba,
    "pytissueoptics": pytissueoptics,
    "pmcxcl": pmcxcl,
    "labrig": labrig_slab,
}


def run(name: str) -> None:
    """Solve with one, twice, and print the fluence and the second time's CPU seconds."""
    RUNS[name]()  # loads and compiles
    begin = time.process_time()
    found = RUNS[name]()
    print(json.dumps({"fluence": found.tolist(), "cpu_s": time.process_time() - begin}))


def ask(python: Path, name: str) -> dict | str:
    """Return what one found, or why it did not."""
    said = subprocess.run(
        [python, __file__, name], capture_output=True, text=True, check=False, cwd=ROOT
    )
    lines = said.stdout.strip().splitlines()
    if said.returncode == 0 and lines:
        return dict(json.loads(lines[-1]))
    words = [line for line in (said.stdout + said.stderr).splitlines() if line.strip()]
    return words[-1].strip() if words else f"ended with {said.returncode}"


def installed(name: str) -> Path | str:
    """Return the Python of an environment that holds a peer, made if need be, or why not."""
    folder = ROOT / "build" / "peers" / name
    python = folder / "bin" / "python"
    if not (folder / "installed").is_file():
        venv.create(folder, with_pip=True, clear=True)
        said = subprocess.run(
            [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", name, "numpy"],
            capture_output=True,
            text=True,
            check=False,
        )
        if said.returncode:
            return (said.stderr.strip().splitlines() or ["pip failed"])[-1]
        (folder / "installed").touch()
    return python


def main() -> None:
    """Ask all, and print a line each."""
    found: dict[str, dict | str] = {}
    for name in PEERS:
        python = installed(name)
        found[name] = ask(python, name) if isinstance(python, Path) else f"not installed: {python}"
    found["labrig"] = ask(Path(sys.executable), "labrig")
    exact = found["PythonicDISORT"]
    truth = np.array(exact["fluence"]) if isinstance(exact, dict) else None
    print(f"diffuse fluence at optical depths {', '.join(f'{x:g}' for x in PLACES)} of {DEPTH:g}")
    for name, one in found.items():
        if isinstance(one, str):
            print(f"{name:15} cannot be run here: {one[:150]}")
            continue
        shown = " ".join(f"{value:8.5f}" for value in one["fluence"])
        off = "truth"
        if truth is not None and name != "PythonicDISORT":
            rms = math.sqrt(float(np.mean((np.array(one["fluence"]) / truth - 1.0) ** 2)))
            off = f"rms {rms:.1e}"
            if name in BY_CHANCE:
                off += f", 1 % in {one['cpu_s'] * (rms / 0.01) ** 2:.0f} CPU s"
        print(f"{name:15} {shown}  {one['cpu_s']:7.3f} CPU s, {off}")
    print(f"labrig's are {N_BOUNCES} bounces, each by itself; the others' all together.")


if __name__ == "__main__":
    os.environ.setdefault("PTO_DISABLE_3D", "1")
    if sys.argv[1:]:
        run(sys.argv[1])
    else:
        main()
