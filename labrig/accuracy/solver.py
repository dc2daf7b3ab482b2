"""What accuracy costs: every method and resolution against the best truth a scene has."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid, equal_angles
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array
from analysis.transport.choose import Resolution, guess, relative_error, resolvable
from analysis.transport.engines import SAMPLED_CELLS
from analysis.transport.exhaustive import predict_s, solve_exhaustive
from analysis.transport.montecarlo import SampledField, simulate
from analysis.transport.ordinates import DType, second_fluence, solve_on
from analysis.transport.refine import SECOND_TIMES, SINGLE_DEPTHS
from analysis.transport.solve import choose, solve
from labrig.accuracy.costs import Costs, Run, Witness, with_front
from labrig.accuracy.truth import Truth, find_truth
from labrig.errors import LabrigError
from labrig.models.scene import Scene
from labrig.scene.filled import refuse_layer

TOLERANCES = (1e-2, 1e-3, 1e-4)
CELLS = (
    1 / 20,
    1 / 14,
    1 / 10,
    1 / 7,
    1 / 5,
    0.28,
    0.4,
    0.56,
    0.8,
    1.13,
    1.4,
)  # of the finest guess
FINE_SHARE, FINE_DIRECTIONS = 0.7, (96, 512)  # on finer grids fewer directions are a waste
DIRECTIONS = (32, 48, 64, 96, 128, 192, 256)
SECOND_DIRECTIONS = (64, 128, 256, 512, 1024, 2048)
MOST_RADIANCES = 1.9e8  # of one setting, some seconds
MOST_SECOND = 2.6e8  # nodes times directions
PATHS = tuple(4096 * 4**n for n in range(7))
MOST_SAMPLING_S = 2.5  # sampling stops after a run that took longer
EXHAUSTIVE_CELLS = (10, 16, 24, 36, 48)  # along the longer side
MOST_EXHAUSTIVE_S = 3.0
REPEATED_S = 0.1  # a run is repeated for so long, at most TIMES times
TIMES = 8

Followed = Callable[[str, int, int], None]
T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    medium: Medium
    tank: Tank
    beam: Beam
    orders: int

    @property
    def dtype(self) -> DType:
        optical = self.medium.sigma_t_per_mm * float(
            np.hypot(self.tank.depth_mm, self.tank.width_mm)
        )
        return np.float32 if SINGLE_DEPTHS[0] < optical < SINGLE_DEPTHS[1] else np.float64


def cost_of_accuracy(scene: Scene, *, orders: int, progress: Followed) -> Costs:
    """Run every method on a scene and hold it to the best truth there is.

    Raises
    ------
    LabrigError
        If the scene scatters nothing, or keeps light so near its line that no grid is used.
    """
    if orders < 3:
        msg = f"orders = {orders}: the cost of accuracy is told from three orders on."
        raise LabrigError(msg)
    refuse_layer(scene, "the cost of accuracy")
    task = _Task(
        medium=scene.medium.record(),
        tank=scene.tank.record(),
        beam=scene.beam.record().entering(scene.tank.record()),
        orders=orders,
    )
    choice = choose(task.medium, task.tank, task.beam, orders=orders, tolerance=TOLERANCES[-1])
    if choice.engine != "ordinates":
        msg = f"{scene.name}: {choice.reason}; there is no cost of accuracy to measure."
        raise LabrigError(msg)
    truth = find_truth(task.medium, task.tank, task.beam, orders, task.dtype, progress)
    runs: list[Run] = []
    notes: list[str] = []
    runs += _followed("automatic", len(TOLERANCES), _automatic(task, truth, notes), progress)
    grids = _grids(task)
    runs += _followed("ordinates", len(grids), _ordinates(task, truth, grids), progress)
    sampled, witnesses = _sampled(task, truth, progress)
    runs += sampled
    runs += _followed("exhaustive", 2 * len(EXHAUSTIVE_CELLS), _exhaustive(task, truth), progress)
    return Costs(
        scene=scene.name,
        orders=orders,
        truth_error=truth.error,
        runs=with_front(runs),
        witnesses=witnesses,
        notes=notes,
    )


def _followed(what: str, total: int, groups: Iterable[list[Run]], progress: Followed) -> list[Run]:
    progress(what, 0, total)
    runs = []
    for done, group in enumerate(groups, start=1):
        runs += group
        progress(what, done, total)
    progress(what, total, total)
    return runs


def _worst(errors: Array) -> dict[str, Any]:
    return {"error": float(errors.max()), "worst_order": int(errors.argmax()) + 2}


def timed(call: Callable[[], T]) -> tuple[T, float]:
    """Return what a call returns, and the CPU seconds of its best run of several."""
    runs: list[float] = []
    while len(runs) < TIMES and sum(runs) < REPEATED_S:
        begin = time.process_time()
        found = call()
        runs.append(time.process_time() - begin)
    return found, min(runs)


def _automatic(task: _Task, truth: Truth, notes: list[str]) -> Iterator[list[Run]]:
    def answer(tolerance: float) -> BounceField:
        return solve(
            task.medium,
            task.tank,
            task.beam,
            orders=task.orders,
            tolerance=tolerance,
            light_field=False,
        )

    for tolerance in TOLERANCES:
        try:
            field, cpu_s = timed(partial(answer, tolerance))
        except AnalysisError as error:
            notes.append(f"automatic at {tolerance:g}: {error}")
            continue
        grid, stated = field.grid, field.error_estimate
        if not isinstance(grid, Grid):
            continue
        yield [
            Run(
                method="automatic",
                setting=f"tolerance {tolerance:g}: {grid.n_y - 1} x {grid.n_x - 1} "
                f"cells, {grid.n_theta} directions",
                cpu_s=cpu_s,
                **_worst(truth.errors_on(grid, field.fluence)),
                tolerance=tolerance,
                stated=None if stated is None else float(stated.max()),
            )
        ]


def _grids(task: _Task) -> list[tuple[Resolution, bool]]:
    """Return the cells that are tried, and whether they are fine."""
    finest = guess(task.medium, task.tank, task.beam, TOLERANCES[-1])
    return [
        (
            replace(
                finest,
                cells_x=max(4, 4 * round(finest.cells_x * share / 4)),
                cells_y=max(4, 4 * round(finest.cells_y * share / 4)),
            ),
            share > FINE_SHARE,
        )
        for share in CELLS
    ]


def _ordinates(
    task: _Task, truth: Truth, grids: list[tuple[Resolution, bool]]
) -> Iterator[list[Run]]:
    """Yield the runs of each grid: the marched orders, and the second order summed apart."""
    medium, beam = task.medium, task.beam
    directions = [n for n in DIRECTIONS if n >= resolvable(medium.g)] or [resolvable(medium.g)]
    for cells, fine in grids:
        least, least_second = FINE_DIRECTIONS if fine else (0, 0)
        nodes = (cells.cells_x + 1) * (cells.cells_y + 1)
        apart = _second_apart(
            task, truth, replace(cells, n_theta=directions[0]).grid(task.tank), least_second
        )
        runs = []
        settings = [(n, 1) for n in directions if n >= min(least, directions[-1])]
        settings += [(n, SECOND_TIMES) for n in directions]
        for n_theta, times in settings:
            if nodes * n_theta * (task.orders - 1) > MOST_RADIANCES / times:
                continue
            grid = replace(cells, n_theta=n_theta).grid(task.tank)
            field, cpu_s = timed(
                partial(
                    solve_on,
                    medium,
                    beam,
                    grid,
                    n_bounces=task.orders,
                    light_field=False,
                    dtype=task.dtype,
                    second_times=times,
                )
            )
            error = truth.errors_on(grid, field.fluence)
            name = f"{grid.n_y - 1} x {grid.n_x - 1} cells, {n_theta} directions"
            method = "ordinates" if times == 1 else "ordinates, order 2 finer"
            runs.append(Run(method=method, setting=name, cpu_s=cpu_s, **_worst(error)))
            if times > 1:
                continue
            rest = float(error[1:].max())
            more = [one for one in apart if one[0] > n_theta]
            good = [one for one in more if one[2] <= rest] or more[-1:]
            if good:
                n, more_s, second = good[0]
                runs.append(
                    Run(
                        method="ordinates, order 2 apart",
                        setting=f"{name}, {n} for order 2",
                        cpu_s=cpu_s + more_s,
                        **_worst(np.array([second, *error[1:]])),
                    )
                )
        yield runs


def _second_apart(
    task: _Task, truth: Truth, grid: Grid, least: int
) -> list[tuple[int, float, float]]:
    """Return directions, CPU seconds and error of the second order summed by itself."""
    found = []
    for n in (n for n in SECOND_DIRECTIONS if n >= least):
        if n * grid.n_x * grid.n_y > MOST_SECOND:
            break
        summed, cpu_s = timed(
            partial(second_fluence, task.medium, task.beam, grid, equal_angles(n))
        )
        second = task.medium.sigma_s_per_mm * summed
        found.append((n, cpu_s, truth.second_error_on(grid, second)))
    return found


def _sampled(task: _Task, truth: Truth, progress: Followed) -> tuple[list[Run], list[Witness]]:
    """Return the Monte Carlo's runs, and the witness that the longest bears on the truth."""
    cell_mm = max(task.tank.depth_mm, task.tank.width_mm) / SAMPLED_CELLS

    def follow_paths(n_paths: int) -> SampledField:
        return simulate(
            task.medium,
            task.tank,
            task.beam,
            n_bounces=task.orders,
            n_paths=n_paths,
            cell_mm=cell_mm,
            seed=1,
        )

    follow_paths(PATHS[0])
    runs: list[Run] = []
    for done, n_paths in enumerate(PATHS):
        progress("montecarlo", done, len(PATHS))
        field, cpu_s = timed(partial(follow_paths, n_paths))
        error = truth.errors_over(field.x_mm, field.y_mm, field.fluence)
        setting = f"{n_paths} paths"
        runs.append(Run(method="montecarlo", setting=setting, cpu_s=cpu_s, **_worst(error)))
        if cpu_s > MOST_SAMPLING_S:
            break
    progress("montecarlo", len(PATHS), len(PATHS))
    noise = [relative_error(a + b, a) for a, b in zip(field.fluence, field.std_error, strict=True)]
    pairs = zip(error, noise, strict=True)
    return runs, [
        Witness(order=k, difference=float(miss), noise=float(own))
        for k, (miss, own) in enumerate(pairs, start=2)
    ]


def _exhaustive(task: _Task, truth: Truth) -> Iterator[list[Run]]:
    longer = max(task.tank.depth_mm, task.tank.width_mm)
    for self_cell in (False, True):
        for n in EXHAUSTIVE_CELLS:
            grid = Grid(
                tank=task.tank,
                n_x=max(3, round(n * task.tank.depth_mm / longer)) + 1,
                n_y=max(3, round(n * task.tank.width_mm / longer)) + 1,
                n_theta=max(64, resolvable(task.medium.g)),
            )
            if predict_s(grid, n_bounces=task.orders) > MOST_EXHAUSTIVE_S:
                break
            field, cpu_s = timed(
                partial(
                    solve_exhaustive,
                    task.medium,
                    task.beam,
                    grid,
                    n_bounces=task.orders,
                    self_cell=self_cell,
                )
            )
            with_own = "with" if self_cell else "without"
            yield [
                Run(
                    method=f"exhaustive {with_own} self cell",
                    setting=f"{grid.n_y} x {grid.n_x} cells",
                    cpu_s=cpu_s,
                    **_worst(truth.errors_on(grid, field.fluence)),
                )
            ]
