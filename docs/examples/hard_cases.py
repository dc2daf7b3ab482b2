"""Solve what is hard and print one table: case, engine, stated and true error, CPU seconds.

The table of docs/hard-cases.md; takes some four minutes.
"""

import math
import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.special import gammaln

from analysis.errors import AnalysisError
from analysis.light_field import BounceField
from analysis.medium import Beam, Medium, Tank
from analysis.transport.choose import relative_error
from analysis.transport.solve import solve

TANK, BEAM = Tank(depth_mm=100.0, width_mm=75.0), Beam(from_mm=25.0, to_mm=50.0)
SIGMA_T, MEMORY_BYTES = 0.2051, 4e9
Truth = Callable[[BounceField], tuple[int, np.ndarray]]


def medium(sigma_t: float = SIGMA_T, albedo: float = 0.9, g: float = 0.4, **more: str) -> Medium:
    """Return a medium by its albedo."""
    return Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=albedo * sigma_t, g=g, **more)


def forward(field: BounceField) -> tuple[int, np.ndarray]:
    """Return order 4 of the limit g = 1."""
    x, s = field.grid.x_mm, field.medium.sigma_s_per_mm
    with np.errstate(divide="ignore"):
        along = np.exp(3.0 * np.log(s * x) - gammaln(4.0) - field.medium.sigma_t_per_mm * x)
    return 4, field.fluence[0][:, :1] * along


def backward(field: BounceField) -> tuple[int, np.ndarray]:
    """Return order 2 of the rod model, g = -1."""
    x, t = field.grid.x_mm, field.medium.sigma_t_per_mm
    share = field.medium.sigma_s_per_mm / (2.0 * t)
    along = share * (np.exp(-t * x) - np.exp(-t * (2.0 * field.grid.tank.depth_mm - x)))
    return 2, field.fluence[0][:, :1] * along


def corners(field: BounceField) -> tuple[int, np.ndarray]:
    """Return order 2 without extinction, g = 0, the whole face lit."""
    x, y = np.meshgrid(field.grid.x_mm[1:-1], field.grid.y_mm[1:-1])
    tank, total = field.grid.tank, np.zeros(x.shape)
    for a in (x, tank.depth_mm - x):
        for b in (y, tank.width_mm - y):
            total += a * np.arcsinh(b / a) + b * np.arcsinh(a / b)
    inside = np.zeros(field.fluence[1].shape)
    inside[1:-1, 1:-1] = field.medium.sigma_s_per_mm / (2.0 * math.pi) * total
    return 2, inside


def cases() -> list[tuple[str, Medium, Tank, Beam, dict[str, object], Truth | None]]:
    """Return name, scene, what is asked for, and the exact limit where there is one."""
    usual: dict[str, object] = {"orders": 4, "tolerance": 1e-2}
    found: list[tuple[str, Medium, Tank, Beam, dict[str, object], Truth | None]] = []
    for g in (-1.0, -0.999999, -0.95, 0.0, 0.95, 0.99, 0.999999, 1.0):
        truth = {1.0: forward, -1.0: backward}.get(g)
        found.append((f"g = {g:g}", medium(g=g), TANK, BEAM, usual, truth))
    for albedo in (0.0, 0.999, 1.0):
        found.append((f"albedo {albedo:g}", medium(albedo=albedo), TANK, BEAM, usual, None))
    for depth in (1e-6, 1e-3, 1.0, 1e2, 1e3):
        scene = medium(sigma_t=depth / 100.0)
        found.append((f"optical depth {depth:g}", scene, TANK, BEAM, usual, None))
    bare = Medium(sigma_t_per_mm=0.0, sigma_s_per_mm=0.1, g=0.0, gain="allowed")
    whole = Beam(from_mm=0.0, to_mm=75.0)
    thin, long = Tank(depth_mm=1.0, width_mm=1000.0), Tank(depth_mm=1000.0, width_mm=1.0)
    loose: dict[str, object] = {"orders": 4, "tolerance": 5e-2}
    steep = Beam(from_mm=20.0, to_mm=40.0, angle_deg=89.9)
    return [
        *found,
        ("sigma_t = 0, sigma_s kept", bare, TANK, whole, usual, corners),
        ("89.9 degrees", medium(), TANK, steep, loose, None),
        ("beam of 0.1 mm", medium(), TANK, Beam(from_mm=37.0, to_mm=37.1), loose, None),
        ("beam wider than the tank", medium(), TANK, Beam(from_mm=-10.0, to_mm=90.0), usual, None),
        ("tank 1 x 1000", medium(), thin, Beam(from_mm=400.0, to_mm=600.0), usual, None),
        ("tank 1000 x 1", medium(), long, Beam(from_mm=0.25, to_mm=0.75), usual, None),
        ("60 orders", medium(), TANK, BEAM, {"orders": 60, "tolerance": 1e-2}, None),
        ("diverging series", medium(g=0.9, phase="hg-paper"), TANK, BEAM, {}, None),
    ]


def row(
    name: str, scene: tuple[Medium, Tank, Beam], asked: dict[str, object], truth: Truth | None
) -> str:
    """Solve one case and return its line."""
    begin = time.process_time()
    try:
        field = solve(*scene, light_field=False, memory_bytes=MEMORY_BYTES, **asked)  # type: ignore[arg-type]
    except AnalysisError as error:
        return f"| {name} | refused | | | {time.process_time() - begin:.2f} | {error} |"
    seconds = time.process_time() - begin
    sound = np.isfinite(field.fluence).all() and field.fluence.min() >= 0.0
    true = ""
    if truth is not None:
        k, exact = truth(field)
        true = f"{relative_error(np.where(exact > 0, field.fluence[k - 1], 0.0), exact):.1e}"
    stated = f"{np.max(field.error_estimate):.1e}"
    grid = field.grid
    note = f"{grid.n_y} x {grid.n_x} nodes, {grid.n_theta} directions"
    if not sound:
        note += ", NEGATIVE OR NOT FINITE"
    return f"| {name} | {field.engine} | {stated} | {true} | {seconds:.2f} | {note} |"


if __name__ == "__main__":
    sys.stdout.write("| case | engine | stated error | true error | CPU s | |\n")
    sys.stdout.write("| --- | --- | --- | --- | --- | --- |\n")
    for name, scene_medium, tank, beam, asked, truth in cases():
        sys.stdout.write(row(name, (scene_medium, tank, beam), asked, truth) + "\n")
        sys.stdout.flush()
