"""What transport costs, in CPU seconds: `make bench`. In `make test` at toy size, unprinted."""

import json
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.transport.exhaustive import solve_exhaustive
from analysis.transport.montecarlo import simulate
from analysis.transport.ordinates import solve_on
from analysis.transport.solve import solve

MEDIUM = Medium(sigma_t_per_mm=0.2051, sigma_s_per_mm=0.9 * 0.2051, g=0.4)
TANK, BEAM = Tank(depth_mm=100.0, width_mm=75.0), Beam(from_mm=25.0, to_mm=50.0)
SOLVE_GATE_S, FIRST_GATE_S = 0.15, 2.0
GROWTH_GATES = {"cells": 1.1, "angles": 1.2, "orders": 1.1}

FRESH = """\
import json, sys, time
from analysis.medium import Beam, Medium, Tank
from analysis.transport.solve import solve
imported_s = time.process_time()
solve(
    Medium(sigma_t_per_mm=0.2051, sigma_s_per_mm=0.18459, g=0.4),
    Tank(depth_mm=100.0, width_mm=75.0),
    Beam(from_mm=25.0, to_mm=50.0),
    orders=8,
    tolerance=float(sys.argv[1]),
)
print(json.dumps([imported_s, time.process_time() - imported_s]))
"""


@pytest.fixture
def real(request) -> bool:
    """Whether sizes are real and numbers are printed."""
    return bool(request.config.getoption("benchmark_enable"))


def cpu_s(call: Callable[[], object], repeats: int = 3) -> float:
    """Return the CPU seconds of the best call."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return min(times)


def growth(sizes: list[float], seconds: list[float]) -> float:
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def say(text: str, real: bool) -> None:
    if real:
        print(f"\n{text}")  # noqa: T201


def canonical(tolerance: float, orders: int, *, light_field: bool = True):
    return solve(MEDIUM, TANK, BEAM, orders=orders, tolerance=tolerance, light_field=light_field)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_canonical_tank_at_a_tolerance(real, tolerance):
    orders, asked = (8, tolerance) if real else (3, 0.3)
    begin = time.process_time()
    field = canonical(asked, orders)
    seconds = time.process_time() - begin
    assert field.error_estimate.max() <= asked
    if not real:
        return
    if tolerance > 1e-4:  # half a minute is not spent twice; kernels are warm by then
        seconds = cpu_s(lambda: canonical(asked, orders))
    evict = np.ones(64_000_000)  # 512 MB, so that nothing of the light field stays in a cache
    evict += 1.0
    copied_s = cpu_s(field.light_field.copy, 1)
    gate = f" (gate {SOLVE_GATE_S} s)" if tolerance == 1e-3 else ""
    say(
        f"canonical tank, 8 orders, {tolerance:g}: {seconds:.3f} CPU s{gate}, "
        f"{field.grid.n_y} x {field.grid.n_x} x {field.grid.n_theta}, "
        f"{seconds / copied_s:.1f} cold copies of its light field",
        real,
    )


def test_ratio_to_the_monte_carlo_at_equal_error(real):
    n_paths, orders, tolerance = (400_000, 8, 1e-3) if real else (320, 3, 0.3)
    canonical(tolerance, orders, light_field=False)

    def sample():
        return simulate(MEDIUM, TANK, BEAM, n_bounces=orders, n_paths=n_paths, cell_mm=1.0, seed=1)

    noise = float(sample().relative_noise().max())
    sampled_s = cpu_s(sample, 1) * (noise / tolerance) ** 2
    solved_s = cpu_s(lambda: canonical(tolerance, orders, light_field=False))
    assert noise > 0.0
    say(
        f"Monte Carlo on cells of 1 mm: noise {noise:.2g} of {n_paths} paths, so {sampled_s:.0f} "
        f"CPU s at {tolerance:g} by the square law, {sampled_s / solved_s:.0f} times the ordinates",
        real,
    )


def test_ratio_to_the_exhaustive_method_and_how_both_grow(real):
    cells, orders = ((24, 32, 48), 4) if real else ((8, 12), 2)
    swept, gathered = [], []
    for n in cells:
        grid = Grid(tank=TANK, n_x=n + 1, n_y=3 * n // 4 + 1, n_theta=64)

        def sweep(grid=grid):
            return solve_on(MEDIUM, BEAM, grid, n_bounces=orders)

        def gather(grid=grid):
            return solve_exhaustive(MEDIUM, BEAM, grid, n_bounces=orders, self_cell=True)

        sweep(), gather()
        swept.append(cpu_s(sweep))
        gathered.append(cpu_s(gather))
    nodes = [float((n + 1) * (3 * n // 4 + 1)) for n in cells]
    assert min(gathered + swept) > 0.0
    say(
        f"exhaustive: {gathered[-1] / swept[-1]:.0f} times the ordinates on the same "
        f"{nodes[-1]:.0f} nodes, grows as cells^{growth(nodes, gathered):.2f}",
        real,
    )


@pytest.mark.parametrize("what", list(GROWTH_GATES))
def test_growth(real, what):
    cells, angles, orders = (160, 64, 8) if real else (16, 32, 3)
    sizes, marches = [], []
    for factor in (1, 2, 4):
        n = {"cells": cells, "angles": angles, "orders": orders}
        n[what] *= factor
        wide = 4 * round(cells * (factor**0.5 if what == "cells" else 1.0) / 4)
        grid = Grid(tank=TANK, n_x=wide + 1, n_y=3 * wide // 4 + 1, n_theta=n["angles"])

        def march(grid=grid, k=n["orders"]):
            return solve_on(MEDIUM, BEAM, grid, n_bounces=k, light_field=False, dtype=np.float32)

        assert np.isfinite(march().fluence).all()
        sizes.append({"cells": grid.n_x * grid.n_y, "angles": grid.n_theta}.get(what, n["orders"]))
        marches.append(march)
    # By turns: a host's slow minute is everybody's.
    turns = [[cpu_s(march, 1) for march in marches] for _ in range(7 if real else 1)]
    seconds = [min(turn) for turn in zip(*turns, strict=True)]
    say(
        f"growth in {what}: exponent {growth(sizes, seconds):.2f} (gate {GROWTH_GATES[what]}) "
        f"from {sizes[0]} to {sizes[-1]}",
        real,
    )


def test_first_call_in_a_fresh_process(real):
    tolerance = "1e-3" if real else "0.3"
    command = [sys.executable, "-c", FRESH, tolerance]
    for _ in range(2 if real else 1):  # the first one may compile
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    imported_s, first_s = json.loads(done.stdout)
    assert imported_s > 0.0
    assert first_s > 0.0
    say(
        f"fresh process, kernels cached: {imported_s:.2f} CPU s to import, {first_s:.2f} for the "
        f"first call (gate {FIRST_GATE_S} s in all)",
        real,
    )
