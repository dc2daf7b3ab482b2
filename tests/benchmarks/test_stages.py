"""What each stage costs: `make bench`. In `make test` each runs once, at toy size."""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.separation import separate_extrema, separate_harmonic, separate_known
from analysis.transport.montecarlo import simulate
from analysis.transport.ordinates import march
from calibration.hdr import merge
from calibration.model import CameraModel
from calibration.projector import stripe_light
from labrig.session import SessionWriter

CAMERA = CameraModel(
    bits=12, black_level_dn=16.0, white_level_dn=4095.0, gain_dn_per_e=0.28, read_noise_e=10.9
)
BRACKET = (0.01, 0.02, 0.04, 0.08)
MEDIUM = Medium(sigma_t_per_mm=0.2051, sigma_s_per_mm=0.9 * 0.2051, g=0.4)
TANK, BEAM = Tank(depth_mm=100.0, width_mm=75.0), Beam(from_mm=25.0, to_mm=50.0)


@pytest.fixture
def shape(benchmark) -> tuple[int, int]:
    """One megapixel, or a stamp where nothing is timed."""
    return (24, 32) if benchmark.disabled else (1000, 1000)


def cpu_s(call, n=7) -> float:
    """Return the CPU seconds of a call, the least of several: others share the machine."""
    spent = []
    for _ in range(n):
        begin = time.process_time()
        call()
        spent.append(time.process_time() - begin)
    return min(spent)


def bracket(shape: tuple[int, int]) -> list[np.ndarray]:
    """A scene that fades over two decades, saturated at its bright end in the long exposures."""
    rng = np.random.default_rng(1)
    light = 5e4 * np.exp(-4.0 * np.arange(shape[1]) / shape[1]) * np.ones(shape)
    return [
        np.clip(np.rint(16.0 + 0.28 * rng.poisson(light * t / 0.28)), 0, 4095).astype(np.uint16)
        for t in BRACKET
    ]


def test_merge_of_four_exposures(benchmark, shape):
    """The merge per megapixel, beside OpenCV's MergeDebevec and a copy of the stack."""
    frames = bracket(shape)
    merge(frames, BRACKET, (16.0,) * 4, CAMERA)
    benchmark(merge, frames, BRACKET, (16.0,) * 4, CAMERA)
    if benchmark.enabled:
        ours = cpu_s(lambda: merge(frames, BRACKET, (16.0,) * 4, CAMERA))
        times, response = np.float32(BRACKET), np.arange(65536, dtype=np.float32)[:, None, None]
        other = cv2.createMergeDebevec()
        theirs = cpu_s(lambda: other.process(frames, times, response))
        copied = cpu_s(np.stack(frames).copy)
        print(  # noqa: T201
            f"\nmerge of 4 exposures: {1e3 * ours:.0f} ms/MP CPU (limit 100); MergeDebevec, "
            f"without variance, {1e3 * theirs:.0f}; copy {1e3 * copied:.1f}"
        )
        assert ours < 0.2  # twice the limit, which is printed: others share the machine


def two_threads_s(call, n=7) -> float:
    """Return the seconds of two calls at once on two threads, the least of several."""
    spent = []
    with ThreadPoolExecutor(2) as pool:
        for _ in range(n):
            begin = time.perf_counter()
            for done in [pool.submit(call) for _ in range(2)]:
                done.result()
            spent.append(time.perf_counter() - begin)
    return min(spent)


@pytest.mark.parametrize("method", ["known-pattern", "known-map", "harmonic", "extrema"])
def test_separation_of_six_shifts(benchmark, shape, method):
    """A separation per megapixel with variance and mask, beside a copy of what it reads."""
    net = np.random.default_rng(1).random((6, *shape)).astype(np.float32)
    variance = net + np.float32(1.0)
    pattern = stripe_light(
        np.arange(shape[0])[:, None] * 0.7,
        period_px=12.0,
        duty=0.5,
        n_shifts=6,
        blur_px=0.5,
        pixel_px=0.7,
    ).astype(np.float32)
    known = np.broadcast_to(pattern, net.shape).copy() if method == "known-map" else pattern
    call = {
        "known-pattern": lambda: separate_known(net, variance, known),
        "known-map": lambda: separate_known(net, variance, known),
        "harmonic": lambda: separate_harmonic(net, variance, contrast=0.6, duty=0.5),
        "extrema": lambda: separate_extrema(net, variance),
    }[method]
    call()
    benchmark(call)
    if benchmark.enabled:
        copied = cpu_s(lambda: (net.copy(), variance.copy()))
        ours = cpu_s(call)
        frames = [(600.0 * shift).astype(np.uint16) for shift in net]
        times, response = np.full(6, 0.01, np.float32), np.arange(65536, dtype=np.float32)
        other = cv2.createMergeDebevec()
        theirs = cpu_s(lambda: other.process(frames, times, response[:, None, None]), n=3)
        print(  # noqa: T201
            f"\n{method}, 6 shifts: {1e3 * ours:.0f} ms/MP CPU (limit 20), "
            f"{ours / copied:.1f} times a copy of pictures and variances "
            f"({1e3 * copied:.1f}); OpenCV's MergeDebevec of 6 frames {1e3 * theirs:.0f}; wall of "
            f"two pictures on two threads {1e3 * two_threads_s(call):.0f} ms"
        )
        assert ours < 0.04  # twice the limit, which is printed: others share the machine


def test_canonical_tank_by_ordinates(benchmark):
    """Orders 1 to 8 at 1 mm nodes and 64 angles, and how often one could copy the light field."""
    cell_mm = 10.0 if benchmark.disabled else 1.0
    grid = Grid.covering(TANK, cell_mm=cell_mm, n_theta=64)

    def orders() -> list[np.ndarray]:
        return [light.fluence for light in march(MEDIUM, BEAM, grid, n_bounces=8)]

    orders()
    benchmark(orders)
    if benchmark.enabled:
        light = np.ones((8, grid.n_y, grid.n_x, 64))
        begin = time.process_time()
        light.copy()
        copied_s = time.process_time() - begin
        ratio = benchmark.stats.stats.median / copied_s
        print(f"\ncanonical tank: {ratio:.1f} times one copy of its light field")  # noqa: T201


def test_canonical_tank_by_monte_carlo(benchmark):
    n_paths = 160 if benchmark.disabled else 100_000

    def sample() -> np.ndarray:
        return simulate(
            MEDIUM, TANK, BEAM, n_bounces=8, n_paths=n_paths, cell_mm=1.0, seed=1
        ).fluence

    sample()
    benchmark(sample)


def test_commit_of_a_frame(benchmark, shape, tmp_path: Path):
    n = 3 if benchmark.disabled else 200
    pixels = np.random.default_rng(1).integers(0, 4096, shape).astype(np.uint16)
    shots = [{"id": f"shot-{k}"} for k in range(n)]
    names = iter(shot["id"] for shot in shots)
    with SessionWriter.create(tmp_path, "bench", {"shots": shots}) as session:
        benchmark.pedantic(lambda: session.commit(next(names), 1, pixels, {}), rounds=n - 1)
        session.close()
