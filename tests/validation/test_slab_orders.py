"""Orders of a slab against the 3-D Monte Carlo from isotropic to sharply forward scattering.

The case of g = 0.7 stands in test_slab.py.
"""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from slabs import binned, solved

from analysis.medium import Medium, Slab
from analysis.transport.montecarlo_slab import simulate_slab
from analysis.transport.slab_second import second_order
from analysis.transport.slab_tolerance import solve_to

STRIPES = 2.0 * math.pi / 1.8
MEDIA = [  # sigma_t, albedo, g, height, index, error that sums of orders may have
    pytest.param((0.12, 0.8, 0.0, 5.0, 1.0, 0.003), id="g0"),
    pytest.param((0.12, 0.8, 0.0, 2.0, 1.33, 0.003), id="g0-thin"),
    pytest.param((0.2051, 0.5, 0.4, 5.0, 1.33, 0.003), id="g0.4"),
    pytest.param((0.35, 0.95, 0.9, 5.0, 1.33, 0.006), id="g0.9"),
]
N_BINS, N_SAMPLES = 12, 5


@pytest.mark.parametrize("case", MEDIA)
def test_orders_are_the_monte_carlo(case):
    """12 s of processor time for all: paths enough to see the 0.3 % of a sum.

    A sample of sixteen batches knows its error to 18 % only, and its twelve bins are of the same
    paths: the pulls of one are 0.5 to 1.6 rms by chance. Those of five tell whether errors are
    true; 1.07 is what sixteen batches lead to.
    """
    sigma_t, albedo, g, height_mm, index, of_sum = case
    slab = Slab(depth_mm=30.0, height_mm=height_mm, surface_index=index)
    medium = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=albedo * sigma_t, g=g)
    samples = [
        simulate_slab(
            medium,
            slab,
            n_bounces=6,
            n_paths=160_000,
            cell_mm=1.0,
            seed=11 + n,
            wavenumber_per_mm=STRIPES,
            harmonics=(1,),
            n_threads=1,
        )
        for n in range(N_SAMPLES)
    ]
    edges, x = np.arange(N_BINS + 1.0), np.linspace(0.0, N_BINS, 20 * N_BINS + 1)
    near = (..., 0, slice(0, N_BINS))
    white = [(one.light[near], one.std_error[near]) for one in samples]
    striped = [(one.modulated[0].real[near], one.modulated_std_error[0][near]) for one in samples]
    whole = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=sigma_t, g=g)
    pulls = []
    for q, sampled in ((0.0, white), (STRIPES, striped)):
        light, errors = (np.array(part) for part in zip(*sampled, strict=True))
        closed = albedo * second_order(x, whole, slab, wavenumber_per_mm=q)
        pulls.append((light[:, 0] - binned(closed, x, sigma_t, edges)) / errors[:, 0])
        seen, noise = light.mean(axis=0), np.sqrt((errors**2).mean(axis=0) / N_SAMPLES)
        field = solved(whole, slab, q=q, fineness=2.2)
        model = binned(field.camera, field.x_mm, sigma_t, edges)
        model *= albedo ** np.arange(6)[:, None]
        for k in range(3, 7) if q == 0.0 else ():
            ratio = seen[k - 2].sum() / model[k - 1].sum()
            error = np.linalg.norm(noise[k - 2]) / model[k - 1].sum()
            # measured worst 0.55 %, of a noise of 0.1 to 0.4 %
            assert abs(ratio - 1.0) < 0.01 + 2.0 * error
        total, of_all = model[1:].sum(axis=0), seen.sum(axis=0)
        ratio = of_all.sum() / total.sum()
        error = np.linalg.norm(noise) / total.sum()
        # measured worst 0.07 % of white light, 0.19 % of a noise of 0.3 under stripes; at g = 0.9
        # 0.15 % and 0.37 %
        assert abs(ratio - 1.0) < of_sum + 2.0 * error
    rms = float(np.sqrt(np.mean(np.square(pulls))))
    # measured 1.19, 1.16, 1.09, 1.29
    assert 0.9 < rms < 1.3


@pytest.mark.parametrize(
    ("sigma_t", "g", "tolerances"),
    [(0.12, 0.0, (1e-2, 2e-3)), (0.2051, 0.4, (1e-2, 2e-3)), (0.35, 0.9, (3e-2, 1e-2))],
)
def test_a_stated_error_holds_from_isotropic_to_forward(sigma_t, g, tolerances):
    medium = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=sigma_t, g=g)
    slab = Slab(depth_mm=30.0, height_mm=5.0, surface_index=1.33)
    found = [solve_to(medium, slab, tolerance=t, n_bounces=5) for t in tolerances]
    finest = solve_to(medium, slab, tolerance=0.35 * tolerances[-1], n_bounces=5)
    x = np.linspace(0.0, 15.0, 100)
    for one, tolerance in zip(found, tolerances, strict=True):
        assert one.reached
        assert one.error.max() <= tolerance
        mine, true = (
            CubicSpline(f.field.x_mm, f.field.camera, axis=1)(x) * np.exp(-sigma_t * x)
            for f in (one, finest)
        )
        off = np.sqrt(((mine - true) ** 2).mean(axis=1) / (true**2).mean(axis=1))
        # measured at most 1.07 of what is stated, at g = 0.9 a third
        assert (off <= 1.5 * (one.error + 1e-4)).all()
