"""The report says what was found, stands alone, and never says more than is known."""

from __future__ import annotations

import copy
import html
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.errors import RunError
from labrig.reporting.beside_page import write_beside
from labrig.reporting.report_page import CAPTIONS, render, write_report
from labrig.results import Field, Result, read_results, write_results

RUN: dict[str, Any] = {
    "session": {
        "id": "2026-11-22_013115_dilute-milk_6d96",
        "path": "sessions/milk",
        "simulated": True,
        "sealed": True,
    },
    "sigma_t_per_mm": {"value": 0.20476, "std": 0.00031},
    "scale_c": {"value": 57499.6, "std": 5.8},
    "sigma_s_per_mm": {"value": 0.09547, "std": 0.00121},
    "g": {"value": 0.479, "std": 0.034},
    "uncertainty": "std is statistical: camera noise carried through the fits.",
    "length_unit": "mm",
    "model": {"geometry": "flatland", "phase": "hg-plane"},
    "method": {"separation": "known-pattern", "parameters": "stripe-aware"},
    "alternatives": {
        "separated": {
            "sigma_t_per_mm": {"value": 0.2041, "std": 0.0003},
            "scale_c": {"value": 57502.0, "std": 6.0},
        },
        "extrema": {
            "sigma_t_per_mm": {"value": 0.2, "std": 0.0004},
            "scale_c": {"value": 57925.5, "std": 9.0},
        },
        "unseparated": {
            "sigma_t_per_mm": {"value": 0.1539, "std": 0.0002},
            "scale_c": {"value": 73619.2, "std": 7.3},
        },
    },
    "quality": {
        "saturated_fraction": 0.0123,
        "detected_fraction": 0.1658,
        "direct_share_median": None,
        "closure": {"mean": 0.00031, "median": -0.00048, "p16": -0.0129, "p84": 0.0128},
        "attenuation": {"chi2_per_dof": 1.2, "rms_relative": 0.0057, "depth_range": [0.05, 22.55]},
        "attenuation_unseparated": {
            "chi2_per_dof": 2548.75,
            "rms_relative": 0.046,
            "depth_range": [0.05, 30.25],
        },
        "inversion": {
            "rms_relative": 0.03,
            "last_bounce_share": 0.00014,
            "at_limit": False,
            "covariance": None,
        },
    },
    "notes": ["There are no dark frames: the declared black level is the offset."],
    "seconds": {"linearise": 0.87, "invert": 0.36},
    "provenance": {
        "config": {"n_bounces": 12},
        "software": {"python": "3.11.7"},
        "code_sha256": "2c63cffc",
        "calibration": None,
    },
}
TRUTH = {"sigma_t_per_mm": 0.2051, "sigma_s_per_mm": 0.10255, "g": 0.4}


def result_of(folder: Path, run: dict[str, Any], unit: str = "mm") -> Result:
    """Return a result with small pictures, written and read back."""
    light = np.random.default_rng(3).uniform(0.0, 1e4, (12, 16))
    places = {"y": np.arange(12) + 0.5, "x": np.arange(16) + 0.5}
    fields = {
        name: Field(dims=(name,), values=values, unit=unit, meaning=name)
        for name, values in places.items()
    }
    for name in ("captured", "single", "multiple"):
        fields[name] = Field(dims=("y", "x"), values=light, unit="counts/s", meaning=name)
    return read_results(write_results(folder, run, fields, {"length_unit": unit}))


def page_of(folder: Path, run: dict[str, Any], truth: dict[str, float] | None = None) -> str:
    """Return the page without its pictures; these are the same for every run."""
    return render(result_of(folder, run, str(run["length_unit"])), [], truth or {})


def changed(**changes: Any) -> dict[str, Any]:
    return {**copy.deepcopy(RUN), **changes}


def stopped_after_separation() -> dict[str, Any]:
    kept = ("session", "uncertainty", "model", "method", "seconds", "provenance")
    run = {key: copy.deepcopy(RUN[key]) for key in kept}
    quality = {"saturated_fraction": 0.0, "detected_fraction": 1.0, "additivity": -0.018}
    return {**run, "length_unit": "px", "alternatives": {}, "quality": quality, "notes": []}


class Addresses(HTMLParser):
    """Collects what a page loads or links to, and checks that its tags close."""

    VOID = frozenset({"meta", "img", "br", "link"})

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.tags: set[str] = set()
        self.open: list[str] = []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.found += [value or "" for name, value in attrs if name in {"src", "href"}]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def text_of(page: str) -> str:
    body = re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", "", body)))


def row_of(page: str, name: str) -> list[str]:
    """Return the cells of the first row whose first cell begins so."""
    for row in re.findall(r"<tr>(.*?)</tr>", page, flags=re.DOTALL):
        cells = [text_of(cell).strip() for cell in re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL)]
        if cells and cells[0].startswith(name):
            return cells
    pytest.fail(f"no row {name!r}")


def test_page_stands_alone_with_its_figures_beside_it(tmp_path: Path) -> None:
    result = result_of(tmp_path, changed())
    page_path = write_report(result)
    assert page_path == result.path / "report.html"
    page = page_path.read_text(encoding="utf-8")
    parsed = Addresses(page)
    assert parsed.found
    assert all(address.startswith("data:image/png;base64,iVBOR") for address in parsed.found)
    assert not parsed.tags & {"script", "link", "iframe", "object"}
    assert "http" not in re.sub(r"base64,[^\"]+", "", page)
    assert "@import" not in page
    assert "url(" not in page
    figures = {path.name for path in (result.path / "figures").iterdir()}
    assert figures == {"separation.png", "separation.pdf"}


def test_every_figure_has_a_caption() -> None:
    from labrig.reporting.figure_set import FIGURES  # noqa: PLC0415 - matplotlib is slow to load

    assert set(CAPTIONS) == set(FIGURES)


def test_report_is_written_where_asked(tmp_path: Path) -> None:
    result = result_of(tmp_path / "results", stopped_after_separation(), "px")
    page = write_report(result, tmp_path / "out" / "deep")
    assert page == tmp_path / "out" / "deep" / "report.html"
    assert (page.parent / "figures" / "separation.pdf").is_file()
    assert not (result.path / "report.html").exists()


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RunError, match=r"file.*cannot be written.*--out"):
        write_report(result_of(tmp_path, changed()), tmp_path / "file")


def test_parameters_have_value_std_and_unit(tmp_path: Path) -> None:
    page = page_of(tmp_path, changed())
    assert row_of(page, "extinction") == ["extinction", "σt", "0.2048 ± 0.0003", "mm⁻¹"]
    assert row_of(page, "scattering") == ["scattering", "σs", "0.0955 ± 0.0012", "mm⁻¹"]
    assert row_of(page, "asymmetry") == ["asymmetry", "g", "0.48 ± 0.03", "1"]
    assert row_of(page, "scale")[2:] == ["57500 ± 6", "counts/s"]
    assert row_of(page, "absorption")[2] == "0.1093 ± —"
    assert RUN["uncertainty"] in text_of(page)
    assert "truth" not in text_of(page)


def test_truth_stands_beside_what_was_found(tmp_path: Path) -> None:
    page = page_of(tmp_path, changed(), {**TRUTH, "depth_of_field_mm": 3.0})
    assert row_of(page, "extinction")[4:] == ["0.2051", "−0.17 %"]
    assert row_of(page, "asymmetry")[4:] == ["0.4", "+0.079"]
    assert row_of(page, "absorption")[4:] == ["0.10255", "+6.6 %"]
    assert row_of(page, "scale")[4:] == ["—", "—"]
    assert row_of(page, "depth_of_field_mm")[2:] == ["—", "1", "3", "—"]
    assert row_of(page, "Eq. 9 on light without")[3:] == ["−25 %", "−25 %"]


def test_alternatives_stand_side_by_side(tmp_path: Path) -> None:
    page = page_of(tmp_path, changed())
    assert row_of(page, "stripe-aware (chosen)")[1] == "0.2048 ± 0.0003"
    assert row_of(page, "Eq. 9 on single scattering, known-pattern")[1] == "0.2041 ± 0.0003"
    assert row_of(page, "Eq. 9 on single scattering, extrema")[1:4] == [
        "0.2000 ± 0.0004",
        "57926 ± 9",
        "−2.3 %",
    ]
    assert row_of(page, "Eq. 9 on light without separation")[1] == "0.15390 ± 0.00020"


def test_an_alternative_without_a_fit_says_so(tmp_path: Path) -> None:
    page = page_of(tmp_path, changed(alternatives={}))
    cells = row_of(page, "Eq. 9 on light without separation")
    assert cells[1:] == ["—", "—", "no exponential could be fitted"]


@pytest.mark.parametrize(
    ("at_limit", "why"),
    [(False, "noise of the pictures is not known"), (True, "stopped at the end of its range")],
)
def test_an_unknown_std_is_a_dash_with_its_reason(tmp_path: Path, at_limit: bool, why: str) -> None:
    run = changed(g={"value": 0.479, "std": None})
    run["quality"]["inversion"]["at_limit"] = at_limit
    page = page_of(tmp_path, run)
    assert row_of(page, "asymmetry")[2] == "0.479 ± —"
    assert "No std of g (—)" in text_of(page)
    assert why in text_of(page)


def test_residuals_beyond_the_noise_are_told(tmp_path: Path) -> None:
    assert "the error is larger than the std" not in text_of(page_of(tmp_path, changed()))
    run = changed()
    run["quality"]["attenuation"]["chi2_per_dof"] = 27.5
    text = text_of(page_of(tmp_path, run))
    assert "χ² per degree of freedom is 27.5" in text
    assert "the error is larger than the std" in text


def test_quality_time_notes_and_provenance_are_there(tmp_path: Path) -> None:
    page = page_of(tmp_path, changed())
    text = text_of(page)
    assert row_of(page, "pixels saturated")[1] == "1.23 %"
    assert row_of(page, "closure, median")[1] == "−0.048 %"
    assert "2549" in row_of(page, "exponential without separation")[1]
    assert "share of single scattering" not in text
    assert row_of(page, "linearise")[1] == "0.87"
    assert row_of(page, "together")[1] == "1.23"
    assert f"<li>{RUN['notes'][0]}</li>" in page
    assert "2c63cffc" in text
    assert '"n_bounces": 12' in text
    assert "calibration" not in text
    assert page.count("<details") == 3


def test_headline_names_session_date_and_kind(tmp_path: Path) -> None:
    text = text_of(page_of(tmp_path, changed()))
    assert "dilute-milk" in text
    assert "22 November 2026, 01:31 UTC" in text
    assert "simulated" in text
    session = {"id": "bench 7", "path": "p", "simulated": False, "sealed": False}
    page = page_of(tmp_path, changed(session=session))
    assert "<h1>bench 7</h1>" in page
    assert "measured" in text_of(page)
    assert "session of" not in text_of(page)


def test_an_impossible_date_is_shown_as_it_is(tmp_path: Path) -> None:
    session = {**RUN["session"], "id": "2026-13-45_996199_milk_6d96"}
    assert "2026-13-45_996199" in text_of(page_of(tmp_path, changed(session=session)))


def test_what_others_named_is_escaped(tmp_path: Path) -> None:
    nasty = "<script>alert('x')</script> & \"co\""
    run = changed(
        session={**RUN["session"], "id": nasty, "path": nasty},
        notes=[nasty],
        method={**RUN["method"], "separation": nasty},
        provenance={"setup": {"name": nasty}, "software": {nasty: nasty}},
    )
    page = page_of(tmp_path, run)
    assert "<script" not in page
    assert page.count("&lt;script&gt;") >= 6
    assert "script" not in Addresses(page).tags


def test_a_separation_alone_makes_a_report_in_px(tmp_path: Path) -> None:
    page = page_of(tmp_path, stopped_after_separation())
    text = text_of(page)
    assert "stopped after the separation" in text
    assert "lengths in px" in text
    assert " mm" not in text
    assert "Eq. 10" not in text  # no inversion was done
    assert row_of(page, "additivity")[1] == "−1.8 %"


def test_a_run_of_unknown_scale_gives_parameters_per_px(tmp_path: Path) -> None:
    run = {
        key.replace("_per_mm", "_per_px"): value
        for key, value in changed(length_unit="px", alternatives={}).items()
    }
    page = page_of(tmp_path, run)
    assert row_of(page, "extinction")[3] == "px⁻¹"
    assert "mm⁻¹" not in page
    assert " mm" not in text_of(page)


def test_a_run_that_tells_almost_nothing_is_reported(tmp_path: Path) -> None:
    Addresses(page_of(tmp_path, {"length_unit": "mm"}))


def test_two_results_stand_side_by_side(tmp_path: Path) -> None:
    aslant = changed(
        sigma_t_per_mm={"value": 0.20596, "std": 0.0004, "model_std": 0.0},
        notes=["The beam was measured."],
    )
    del aslant["g"]
    first = result_of(tmp_path / "straight", changed())
    page_path = write_beside(first, result_of(tmp_path / "aslant", aslant))
    assert page_path == first.path / "beside.html"
    page = page_path.read_text(encoding="utf-8")
    assert len(Addresses(page).found) == 2
    cells = row_of(page, "extinction")
    # 0.0012 apart, hypot(0.00031, 0.0004) = 0.000506
    assert cells[2:] == ["0.2048 ± 0.0003", "0.2060 ± 0.0004", "mm⁻¹", "+0.0012, 2.4 std"]
    assert row_of(page, "asymmetry")[3:] == ["—", "1", "—"]
    assert "The beam was measured." in text_of(page)
    files = {path.name for path in (page_path.parent / "figures").iterdir()}
    assert files == {f"separation-{n}.{kind}" for n in (1, 2) for kind in ("png", "pdf")}


def test_results_in_different_units_are_not_compared(tmp_path: Path) -> None:
    other = result_of(tmp_path / "px", stopped_after_separation(), "px")
    with pytest.raises(RunError, match=r"is in mm, .* in px: give both sessions a geometry record"):
        write_beside(result_of(tmp_path / "mm", changed()), other)
