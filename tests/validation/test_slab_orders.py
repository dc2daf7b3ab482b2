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
    pytest.param((0.2051, 0.5, 0.4, 5.0, 1.33, 0.003), id="g0.4"),
    pytest.param((0.35, 0.95, 0.9, 5.0, 1.33, 0.006), id="g0.9"),
]
N_BINS = 12


@pytest.mark.parametrize("case", MEDIA)
def test_orders_are_the_monte_carlo(case):
    """8 s of processor time for all: paths enough to see the 0.3 % of a sum."""
    sigma_t, albedo, g, height_mm, index, of_sum = case
    slab = Slab(depth_mm=30.0, height_mm=height_mm, surface_index=index)
    medium = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=albedo * sigma_t, g=g)
    sample = simulate_slab(
        medium,
        slab,
        n_bounces=6,
        n_paths=800_000,
        cell_mm=1.0,
        seed=11,
        wavenumber_per_mm=STRIPES,
        harmonics=(1,),
        n_threads=1,
    )
    edges, x = np.arange(N_BINS + 1.0), np.linspace(0.0, N_BINS, 20 * N_BINS + 1)
    near = (slice(None), 0, slice(0, N_BINS))
    for q, seen, noise in (
        (0.0, sample.light[near], sample.std_error[near]),
        (STRIPES, sample.modulated[0].real[near], sample.modulated_std_error[0][near]),
    ):
        whole = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=sigma_t, g=g)
        closed = albedo * second_order(x, whole, slab, wavenumber_per_mm=q)
        pull = (seen[0] - binned(closed, x, sigma_t, edges)) / noise[0]
        rms = float(np.sqrt(np.mean(pull**2)))
        # measured 1.1 to 1.4; an error known to 18 % and 12 bins allow 0.5 to 1.6
        assert 0.5 < rms < 1.6
        field = solved(whole, slab, q=q, fineness=2.2)
        model = binned(field.camera, field.x_mm, sigma_t, edges)
        model *= albedo ** np.arange(6)[:, None]
        for k in range(3, 7) if q == 0.0 else ():
            ratio = seen[k - 2].sum() / model[k - 1].sum()
            error = np.linalg.norm(noise[k - 2]) / model[k - 1].sum()
            # measured worst 0.6 %, of a noise of 0.1 to 0.4 %
            assert abs(ratio - 1.0) < 0.01 + 2.0 * error
        total, of_all = model[1:].sum(axis=0), seen.sum(axis=0)
        ratio = of_all.sum() / total.sum()
        error = np.linalg.norm(noise) / total.sum()
        # measured worst 0.1 % of white light, and 0.4 of a noise of 0.4 under stripes
        assert abs(ratio - 1.0) < of_sum + 2.0 * error


@pytest.mark.parametrize(
    ("sigma_t", "g", "tolerances"),
    [(0.12, 0.0, (1e-2, 2e-3)), (0.2051, 0.4, (1e-2, 2e-3)), (0.35, 0.9, (3e-2, 1e-2))],
)
def test_a_stated_error_holds_from_isotropic_to_forward(sigma_t, g, tolerances):
    medium = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=sigma_t, g=g)
    slab = Slab(depth_mm=30.0, height_mm=5.0, surface_index=1.33)
    found = [solve_to(medium, slab, tolerance=t, n_bounces=5) for t in tolerances]
    finest = solve_to(medium, slab, tolerance=0.2 * tolerances[-1], n_bounces=5)
    x = np.linspace(0.0, 15.0, 100)
    for one, tolerance in zip(found, tolerances, strict=True):
        assert one.reached
        assert one.error.max() <= tolerance
        mine, true = (
            CubicSpline(f.field.x_mm, f.field.camera, axis=1)(x) * np.exp(-sigma_t * x)
            for f in (one, finest)
        )
        off = np.sqrt(((mine - true) ** 2).mean(axis=1) / (true**2).mean(axis=1))
        # measured 0.9 and 0.7 of what is stated at most, and 1.64 at g = 0.9
        assert (off <= 2.0 * one.error + 1e-4).all()
