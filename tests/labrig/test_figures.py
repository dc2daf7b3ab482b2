"""Figures show what a result holds: units, shared scales, true directions, and nothing cut off."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from labrig.reporting import drawing, figure_set, figures, views
from labrig.results import Field, Result, read_results, write_results

SIGMA_T, SIGMA_S, ANGLE = 0.2, 0.1, 0.0
DEPTH, HEIGHT, PIXEL, CELL = 40.0, 30.0, 0.25, 2.0
BEAM = (10.0, 20.0)
SCALE_C = 5e4
N_THETA, N_BOUNCES = 16, 6
FORWARD = {k: 4.0 / k for k in range(2, N_BOUNCES + 1)}  # sharpness of exp(s cos theta)


def axis(name: str, values: np.ndarray, unit: str) -> Field:
    return Field(dims=(name,), values=values, unit=unit, meaning=name)


def lit_by(order: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return light that peaks deeper and spreads wider with its order, (n_y, n_x)."""
    middle = 0.5 * sum(BEAM)
    if order == 1:
        inside = (y > BEAM[0]) & (y < BEAM[1])
        return inside[:, None] * np.exp(-SIGMA_T * x)
    across = np.exp(-(((y - middle) / (3.0 + 2.0 * order)) ** 2))
    return 0.5**order * across[:, None] * (0.3 + x) ** (order - 1) * np.exp(-0.35 * x) / 4.0**order


def pictures_of(dims: tuple[str, str], suffix: str, unit: str, pixel: float) -> dict[str, Field]:
    rng = np.random.default_rng(1)
    y, x = ((np.arange(round(n / PIXEL)) + 0.5) * PIXEL for n in (HEIGHT, DEPTH))
    single = SCALE_C * lit_by(1, x, y)
    multiple = SCALE_C * sum(lit_by(k, x, y) for k in range(2, 5))
    stripes = (np.arange(y.size) // 6 % 2)[:, None]
    white = (single + multiple) * (1.0 + 0.01 * rng.standard_normal(single.shape))
    gap = np.where(white > 0.05 * white.max(), (single + multiple) / white - 1.0, np.nan)
    values = {
        "captured": single * stripes + 0.5 * multiple,
        "single": single - 20.0,  # noise makes some of it negative
        "multiple": multiple,
        "single_variance": np.full(single.shape, np.nan),
        "white": white,
        "closure": gap,
    }
    return {
        dims[0]: axis(dims[0], y * pixel / PIXEL, unit),
        dims[1]: axis(dims[1], x * pixel / PIXEL, unit),
        **{
            name + suffix: Field(
                dims=dims, values=v.astype(np.float32), unit="counts/s", meaning=name
            )
            for name, v in values.items()
        },
    }


def profiles_of(unit: str) -> dict[str, Field]:
    depth = (np.arange(round(DEPTH / PIXEL)) + 0.5) * PIXEL
    found = {}
    for name, bend in (("single", 0.0), ("white", 1.5)):
        value = SCALE_C * np.exp(-SIGMA_T * depth) * (1.0 + bend * np.tanh(depth / 20.0))
        value[-5:] = -1.0
        found |= {
            f"{name}_depth": axis(f"{name}_depth", depth, unit),
            **{
                f"{name}_{what}": Field(
                    dims=(f"{name}_depth",), values=v, unit="counts/s", meaning=what
                )
                for what, v in (
                    ("profile", value),
                    ("profile_std", 0.01 * np.abs(value)),
                    ("profile_fit", SCALE_C * np.exp(-SIGMA_T * depth)),
                )
            },
        }
    return found


def solver_fields(unit: str) -> dict[str, Field]:
    x, y = np.arange(0.0, DEPTH + 1.0, CELL), np.arange(0.0, HEIGHT + 1.0, CELL)
    theta = 2.0 * np.pi * (np.arange(N_THETA) + 0.5) / N_THETA
    fluence = np.stack([lit_by(k, x, y) for k in range(1, N_BOUNCES + 1)])
    shape = np.stack([np.exp(s * np.cos(theta)) for s in FORWARD.values()])
    light = fluence[1:, :, :, None] * shape[:, None, None, :]
    residual = np.random.default_rng(2).normal(0.0, 50.0, fluence.shape[1:])
    model = SCALE_C * fluence[1:].sum(axis=0)
    residual[0], residual[:, 0] = np.nan, np.nan
    on_nodes = ("y", "x")
    return {
        "x": axis("x", x, unit),
        "y": axis("y", y, unit),
        "theta": axis("theta", theta, "rad"),
        "bounce": axis("bounce", np.arange(1, N_BOUNCES + 1), "1"),
        "scattered_bounce": axis("scattered_bounce", np.arange(2, N_BOUNCES + 1), "1"),
        "multiple": Field(
            dims=on_nodes, values=model + np.nan_to_num(residual), unit="counts/s", meaning=""
        ),
        "residual": Field(dims=on_nodes, values=residual, unit="counts/s", meaning=""),
        "lit": Field(
            dims=on_nodes,
            values=SCALE_C * fluence.sum(axis=0) + residual,
            unit="counts/s",
            meaning="",
        ),
        "remainder": Field(dims=on_nodes, values=residual, unit="counts/s", meaning=""),
        "fluence": Field(dims=("bounce", *on_nodes), values=fluence, unit="1", meaning=""),
        "light_field": Field(
            dims=("scattered_bounce", *on_nodes, "theta"),
            values=light.astype(np.float32),
            unit="1/rad",
            meaning="",
        ),
    }


def waves_of(unit: str) -> dict[str, Field]:
    depth = np.arange(0.2, 30.0, 0.2)
    stripe = SCALE_C * np.exp(-SIGMA_T * depth)[None, :]
    white = stripe * (1.0 + 0.3 * depth) * np.array([[1.0], [0.5]])
    striped, waved = ("period", "wave_depth"), ("wavenumber", "wave_depth")
    found = {
        "wave_depth": axis("wave_depth", depth, unit),
        "period": axis("period", np.array([1.8]), unit),
        "wavenumber": axis("wavenumber", np.array([0.0, 0.1]), f"1/{unit}"),
        "profile_g": axis("profile_g", np.linspace(0.37, 0.43, 7), "1"),
        "profile_chi2": Field(
            dims=("profile_g",), values=np.linspace(-3.0, 3.0, 7) ** 2, unit="1", meaning=""
        ),
        "single_share": Field(
            dims=striped, values=np.full(stripe.shape, 0.9), unit="1", meaning=""
        ),
    }
    for name, dims, values in (("stripe_wave", striped, stripe), ("white_wave", waved, white)):
        for suffix, factor in (("", 1.001), ("_std", 0.002), ("_fit", 1.0)):
            found[f"{name}{suffix}"] = Field(
                dims=dims, values=factor * values, unit="counts/s", meaning=""
            )
    return found


def run_of(unit: str) -> dict[str, object]:
    fit = {"chi2_per_dof": 1.1, "rms_relative": 0.004, "depth_range": [0.1, 20.0]}
    return {
        "session": {"id": "2026-11-22_013115_milk_6d96", "path": "milk", "simulated": True},
        f"sigma_t_per_{unit}": {"value": 0.20476, "std": 0.00031},
        "scale_c": {"value": SCALE_C, "std": 12.0},
        f"sigma_s_per_{unit}": {"value": SIGMA_S, "std": 0.001},
        "g": {"value": 0.4, "std": 0.01},
        "length_unit": unit,
        "alternatives": {
            "separated": {
                f"sigma_t_per_{unit}": {"value": 0.20476, "std": 0.00031},
                "scale_c": {"value": SCALE_C, "std": 12.0},
            },
            "unseparated": {
                f"sigma_t_per_{unit}": {"value": 0.15, "std": None},
                "scale_c": {"value": 6e4, "std": None},
            },
        },
        "quality": {
            "attenuation": fit,
            "attenuation_unseparated": {**fit, "rms_relative": 0.05},
            "stripe_aware": {
                "condition": 4.1,
                "correlation": [[1.0, 0.1, 0.5], [0.1, 1.0, -0.8], [0.5, -0.8, 1.0]],
            },
        },
    }


def full(tmp_path: Path, unit: str = "mm", angle_rad: float = ANGLE) -> Result:
    fields = {
        **pictures_of(("row", "col"), "_image", unit, PIXEL),
        **profiles_of(unit),
        **solver_fields(unit),
        **waves_of(unit),
    }
    attributes = {
        "length_unit": unit,
        "scale_c": SCALE_C,
        "beam_from": BEAM[0],
        "beam_to": BEAM[1],
        "beam_angle_rad": angle_rad,
    }
    return read_results(write_results(tmp_path, run_of(unit), fields, attributes))


def separated(tmp_path: Path) -> Result:
    """Return what a run leaves that stopped after separation, of unknown scale."""
    run = {"session": {"id": "paper", "simulated": False}, "length_unit": "px"}
    fields = pictures_of(("y", "x"), "", "px", 1.0)
    return read_results(write_results(tmp_path, run, fields, {"length_unit": "px"}))


def without(result: Result, *names: str) -> Result:
    fields = {name: field for name, field in result.fields.items() if name not in names}
    return dataclasses.replace(result, fields=fields)


def replaced(result: Result, name: str, values: np.ndarray) -> Result:
    field = dataclasses.replace(result.fields[name], values=values)
    return dataclasses.replace(result, fields={**result.fields, name: field})


def labels_of(figure: Figure) -> set[str]:
    found = {text for panel in figure.axes for text in (panel.get_xlabel(), panel.get_ylabel())}
    return found - {""}


def texts_of(figure: Figure) -> str:
    legends = [p.get_legend() for p in figure.axes if p.get_legend()] + figure.legends
    found = [t.get_text() for legend in legends for t in [*legend.get_texts(), legend.get_title()]]
    return "\n".join(found + [panel.get_title(loc="left") for panel in figure.axes])


@pytest.fixture(scope="module")
def milk(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return full(tmp_path_factory.mktemp("milk"))


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return separated(tmp_path_factory.mktemp("paper"))


@pytest.fixture(scope="module")
def drawn(milk: Result) -> dict[str, Figure]:
    return figure_set.all_figures(milk)


def test_a_full_run_has_every_figure_with_units_on_its_axes(drawn: dict[str, Figure]) -> None:
    # a layer has a figure of its own, which is in labrig/test_layer.py
    assert list(drawn) == [name for name in figure_set.FIGURES if name != "layer"]
    expected = {
        "separation": {"depth x (mm)", "y (mm)", "counts/s, square-root scale"},
        "closure": {
            *("depth x (mm)", "y (mm)", "closure (%)"),
            *("(single + multiple) / white − 1 (%)", "pixels"),
        },
        "attenuation": {"depth along the beam (mm)", "light (counts/s)", "residual (%)"},
        "stripes": {
            *("depth (mm)", "light (counts/s mm)", "light (10⁴ counts/s mm)"),
            "off the model (%)",
        },
        "identifiability": {"g", "χ² above its least"},
        "remainder": {"depth x (mm)", "y (mm)", "light (counts/s)"},
        "bounces": {"depth along the beam (mm)", "light (counts/s)", "light / its peak"},
        "light-field": {"depth x (mm)", "y (mm)", "light (counts/s)"},
        "residual": {"depth x (mm)", "y (mm)", "light (counts/s)"},
    }
    assert {name: labels_of(figure) for name, figure in drawn.items()} == expected


def test_a_separation_alone_has_its_two_figures_in_px(paper: Result) -> None:
    found = figure_set.all_figures(paper)
    assert list(found) == ["separation", "closure"]
    for figure in found.values():
        assert {"depth x (px)", "y (px)"} <= labels_of(figure)


def test_figures_of_a_run_in_px_say_px(tmp_path: Path) -> None:
    found = figure_set.all_figures(full(tmp_path, unit="px"))
    for name, figure in found.items():
        # what is told apart has no lengths on its axes
        assert name == "identifiability" or any("(px)" in label for label in labels_of(figure))
        assert not any("mm" in label for label in labels_of(figure))
    assert "px⁻¹" in texts_of(found["attenuation"])
    assert "px" in texts_of(found["bounces"])


def test_separated_pictures_share_one_scale(drawn: dict[str, Figure]) -> None:
    captured, single, multiple = drawn["separation"].axes[:3]
    norms = [panel.images[0].norm for panel in (captured, single, multiple)]
    assert norms[0] is norms[1] is norms[2]
    assert {panel.images[0].get_cmap().name for panel in drawn["separation"].axes[:3]} == {
        "cividis"
    }
    assert len(drawn["separation"].axes) == 4  # three pictures, one colour bar


def test_measured_and_modelled_share_a_scale_and_the_residual_is_symmetric(
    drawn: dict[str, Figure],
) -> None:
    measured, model, rest = drawn["residual"].axes[:3]
    assert measured.images[0].norm is model.images[0].norm
    low, high = rest.images[0].get_clim()
    assert low == -high
    assert measured.images[0].norm is not rest.images[0].norm


@pytest.mark.parametrize("name", ["separation", "closure", "light-field", "residual"])
def test_pictures_have_the_lit_face_left_and_rows_run_down(
    drawn: dict[str, Figure], name: str
) -> None:
    panel = drawn[name].axes[0]
    left, right = panel.get_xlim()
    bottom, top = panel.get_ylim()
    assert left < right
    assert bottom > top
    assert left <= 0.5 * CELL


def test_no_text_is_cut_off(milk: Result, paper: Result) -> None:
    for figure in [*figure_set.all_figures(milk).values(), *figure_set.all_figures(paper).values()]:
        drawing.png_bytes(figure)
        page = figure.bbox
        for artist in [*figure.axes, *figure.legends]:
            box = artist.get_tightbbox()
            # anti-aliasing and a marker's edge reach a pixel or two past the layout
            assert min(box.x0 - page.x0, page.x1 - box.x1) > -3.0
            assert min(box.y0 - page.y0, page.y1 - box.y1) > -3.0


def test_attenuation_names_sigma_t_with_its_std(drawn: dict[str, Figure]) -> None:
    text = texts_of(drawn["attenuation"])
    assert "σₜ = 0.2048 ± 0.0003 mm⁻¹" in text
    assert "σₜ = 0.15 ± — mm⁻¹" in text
    assert "(a) without separation" in text
    assert "(b) single scattering" in text


def test_residual_strips_share_a_scale_on_which_single_scattering_is_flat(
    drawn: dict[str, Figure],
) -> None:
    bent, flat = (panel.lines[-1].get_ydata() for panel in drawn["attenuation"].axes[2:4])
    assert np.nanmax(np.abs(flat)) < 1e-9  # the fixture's single light is its own fit
    assert np.nanmax(np.abs(bent)) > 50.0
    assert drawn["attenuation"].axes[2].get_ylim() == drawn["attenuation"].axes[3].get_ylim()


def test_attenuation_without_white_light_has_one_panel(milk: Result) -> None:
    figure = figures.attenuation_figure(without(milk, "white_profile"))
    assert [p.get_title(loc="left") for p in figure.axes] == ["single scattering", ""]


def test_attenuation_draws_light_that_could_not_be_fitted(milk: Result) -> None:
    nothing = np.full(milk.fields["white_profile_fit"].values.shape, np.nan)
    unfitted = replaced(milk, "white_profile_fit", nothing)
    unfitted = replaced(unfitted, "single_profile_std", nothing)
    run = {**milk.run, "alternatives": {}}
    figure = figures.attenuation_figure(dataclasses.replace(unfitted, run=run))
    drawing.png_bytes(figure)
    assert "no exponential was fitted" in texts_of(figure)
    assert "measured, std unknown" in texts_of(figure)


def test_peaks_of_the_bounces_move_inwards(milk: Result, drawn: dict[str, Figure]) -> None:
    depth, orders = views.along_beam(milk)
    peaks = depth[orders.argmax(axis=1)]
    assert np.all(np.diff(peaks) > 0.0)
    for k, at in enumerate(peaks, start=1):
        assert f"bounce {k}, peak {at:.1f} mm" in texts_of(drawn["bounces"])
    assert "measured, white light" in texts_of(drawn["bounces"])


def test_bounces_without_white_light_or_without_scattering_are_drawn(milk: Result) -> None:
    dark = milk.fields["fluence"].values.copy()
    dark[2:] = 0.0
    figure = figures.bounces_figure(without(replaced(milk, "fluence", dark), "white_profile"))
    drawing.png_bytes(figure)
    text = texts_of(figure)
    assert "bounce 2" in text
    assert "bounce 3" not in text
    assert "white light" not in text


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, -15.0])
def test_light_along_a_slanted_beam_is_its_exponential_in_the_path(
    tmp_path: Path, angle_deg: float
) -> None:
    angle_rad = math.radians(angle_deg)
    result = full(tmp_path, angle_rad=angle_rad)
    x, fluence = result.fields["x"].values, result.fields["fluence"].values.copy()
    fluence[0] = np.exp(-SIGMA_T * x / math.cos(angle_rad))
    depth, orders = views.along_beam(replaced(result, "fluence", fluence))
    # measured worst 3e-3, from the spline over nodes 2 mm apart, 0.4 mean free paths
    np.testing.assert_allclose(orders[0], SCALE_C * np.exp(-SIGMA_T * depth), rtol=6e-3)


def test_the_beam_ends_where_it_leaves_the_tank(tmp_path: Path) -> None:
    depth, orders = views.along_beam(full(tmp_path, angle_rad=math.radians(40.0)))
    assert np.isfinite(orders).all()
    reach = (HEIGHT - BEAM[0]) / math.sin(math.radians(40.0))
    assert 0.7 * reach < depth[-1] <= reach


@pytest.mark.parametrize(
    ("theta_peak", "towards"), [(0.0, (1, 0)), (0.5 * np.pi, (0, 1)), (np.pi, (-1, 0))]
)
def test_glyph_reaches_farthest_where_light_travels(
    theta_peak: float, towards: tuple[int, int]
) -> None:
    theta = 2.0 * np.pi * np.arange(64) / 64
    outline = views.glyph(theta, np.exp(5.0 * np.cos(theta - theta_peak)), (3.0, 7.0), 2.0)
    step = outline - [3.0, 7.0]
    distance = np.hypot(*step.T)
    farthest = step[distance.argmax()]
    np.testing.assert_allclose(farthest, 2.0 * np.array(towards), atol=1e-12)


def test_glyph_of_isotropic_light_is_a_circle() -> None:
    theta = 2.0 * np.pi * (np.arange(32) + 0.5) / 32
    outline = views.glyph(theta, np.full(32, 0.3), (1.0, 2.0), 0.5)
    np.testing.assert_allclose(np.hypot(*(outline - [1.0, 2.0]).T), 0.5, rtol=1e-12)


def test_forward_light_points_right_in_the_figure(drawn: dict[str, Figure]) -> None:
    reached = []
    for panel in drawn["light-field"].axes[:4]:
        outlines = next(c for c in panel.collections if isinstance(c, PolyCollection)).get_paths()
        crosses = panel.collections[-1].get_offsets()
        assert len(outlines) == len(crosses) >= 9
        steps = [path.vertices - cross for path, cross in zip(outlines, crosses, strict=True)]
        ahead = [step[:, 0].max() for step in steps]
        behind = [-step[:, 0].min() for step in steps]
        assert min(ahead) > 0.0
        reached.append(np.mean(behind) / np.mean(ahead))
    assert np.all(np.diff(reached) > 0.0)  # higher orders are more isotropic
    assert reached[0] < 0.1


def test_light_towards_increasing_y_points_down_in_the_figure(milk: Result) -> None:
    light = milk.fields["light_field"].values
    theta = milk.fields["theta"].values
    down = light.max(axis=-1, keepdims=True) * np.exp(4.0 * np.sin(theta))
    figure = figures.light_field_figure(replaced(milk, "light_field", down.astype(np.float32)))
    panel = figure.axes[0]
    outline = next(c for c in panel.collections if isinstance(c, PolyCollection)).get_paths()[0]
    cross = panel.transData.transform(panel.collections[-1].get_offsets()[0])
    step = panel.transData.transform(outline.vertices) - cross
    assert step[np.hypot(*step.T).argmax(), 1] < 0.0  # display coordinates grow upwards


@pytest.mark.parametrize("anisotropy", [0.0, 0.3, 0.9])
def test_mean_cosine_of_a_linear_light_field(milk: Result, anisotropy: float) -> None:
    light, theta = milk.fields["light_field"].values, milk.fields["theta"].values
    linear = np.ones(light.shape, dtype=np.float32) * (1.0 + anisotropy * np.cos(theta))
    found = views.mean_cosine(replaced(milk, "light_field", linear.astype(np.float32)), 3)
    assert found == pytest.approx(0.5 * anisotropy, abs=1e-6)  # float32


@pytest.mark.parametrize("last", [2, 3, 4])
def test_light_field_draws_as_many_bounces_as_there_are(milk: Result, last: int) -> None:
    bounces, light = milk.fields["scattered_bounce"].values, milk.fields["light_field"].values
    short = replaced(milk, "scattered_bounce", bounces[bounces <= last])
    figure = figures.light_field_figure(replaced(short, "light_field", light[: last - 1]))
    assert len([p for p in figure.axes if p.get_title(loc="left")]) == last - 1
    lowest = [p for p in figure.axes if p.get_xlabel()]
    assert len(lowest) == min(2, last - 1)


def test_closure_states_its_spread_and_skips_what_is_unknown(
    milk: Result, drawn: dict[str, Figure]
) -> None:
    gap = 100.0 * milk.fields["closure_image"].values
    assert np.isnan(gap).any()
    text = texts_of(drawn["closure"])
    assert f"mean {np.nanmean(gap, dtype=np.float64):+.2g} %".replace("-", "−") in text
    assert f"median {np.nanmedian(gap):+.2g} %".replace("-", "−") in text
    low, high = drawn["closure"].axes[0].images[0].get_clim()
    assert low == -high


def test_closure_without_any_bright_pixel_says_so(milk: Result) -> None:
    nothing = np.full(milk.fields["closure_image"].values.shape, np.nan, dtype=np.float32)
    figure = figures.closure_figure(replaced(milk, "closure_image", nothing))
    drawing.png_bytes(figure)
    assert "no pixel is bright enough" in [t.get_text() for t in figure.axes[0].texts]


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_pictures_without_light_are_drawn(paper: Result, value: float) -> None:
    for name in ("captured", "single", "multiple", "closure"):
        dark = np.full(paper.fields[name].values.shape, value, dtype=np.float32)
        paper = replaced(paper, name, dark)
    for figure in figure_set.all_figures(paper).values():
        assert drawing.png_bytes(figure).startswith(b"\x89PNG")


def test_reduced_picture_holds_means_of_blocks_in_their_place() -> None:
    values = np.arange(35.0).reshape(5, 7)
    values[0, 0], values[2:4, 2:4] = np.nan, np.nan
    whole = views.Picture(values=values, y=np.arange(5.0), x=np.arange(7.0), unit="mm")
    small = whole.reduced(4)
    assert small.values.shape == (2, 3)
    assert small.values[0, 0] == pytest.approx((1.0 + 7.0 + 8.0) / 3.0)
    assert small.values[0, 2] == pytest.approx((4.0 + 5.0 + 11.0 + 12.0) / 4.0)
    assert np.isnan(small.values[1, 1])
    assert small.extent == (-0.5, 5.5, 3.5, -0.5)


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.204759, 1.1e-5, "0.204759 ± 0.000011"),
        (0.204759, 3.1e-4, "0.2048 ± 0.0003"),
        (57499.56, 5.84, "57500 ± 6"),
        (-0.4788, 0.0296, "−0.48 ± 0.03"),
        (0.4788, None, "0.4788 ± —"),
        (0.4788, 0.0, "0.4788 ± —"),
        (0.4788, math.inf, "0.4788 ± —"),
        (0.0, 0.1, "0.00 ± 0.10"),
        (3.21e-6, 4.6e-8, "(3.21 ± 0.05)·10⁻⁶"),
        (2.5e7, None, "(2.5 ± —)·10⁷"),
    ],
)
def test_values_have_the_digits_their_std_deserves(
    value: float, std: float | None, text: str
) -> None:
    assert views.with_std(value, std) == text


def test_saved_files_are_png_and_pdf_and_the_same_each_time(milk: Result, tmp_path: Path) -> None:
    draw: Callable[[Result], Figure] = figures.attenuation_figure
    written = drawing.save(draw(milk), tmp_path / "first.v1")
    drawing.save(draw(milk), tmp_path / "second")
    assert (tmp_path / "first.v1.png").read_bytes() == written
    assert written.startswith(b"\x89PNG")
    assert (tmp_path / "first.v1.pdf").read_bytes().startswith(b"%PDF")
    for ending in ("png", "pdf"):
        first = (tmp_path / f"first.v1.{ending}").read_bytes()
        assert first == (tmp_path / f"second.{ending}").read_bytes()
