"""Results: what files hold, by any reader, and how damaged ones are refused."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import labrig
from labrig.models.analysis import Analysis
from labrig.session import Session
from labrig.session.format import sha256_of
from labrig.steps.record import code_digest

Counts = NDArray[np.uint16]
Complaint = Callable[..., str]

ROOT = Path(__file__).resolve().parents[2]
SHAPE = (60, 90)
CAMERA = {"bits": 12, "black_level_dn": 16, "white_level_dn": 4095}
NOISE = {"gain_dn_per_e": 0.28, "read_noise_e": 10.9}
N_SHOTS = 20  # of the small session: ten pictures at two exposures


@pytest.fixture(scope="module")
def small_result(small_session: Path, tmp_path_factory: pytest.TempPathFactory) -> labrig.Result:
    return labrig.analyse(small_session, out=tmp_path_factory.mktemp("results"))


@pytest.fixture
def result_copy(small_result: labrig.Result, tmp_path: Path) -> Path:
    return shutil.copytree(small_result.path, tmp_path / "result")


def cut_in_half(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip_a_picture(path: Path) -> None:
    """Turn a bit of the stored single scattering, which only its checksum can tell."""
    with h5py.File(path) as file:
        at = file["single_image"].id.get_chunk_info(0).byte_offset + 1000
    content = bytearray(path.read_bytes())
    content[at] ^= 0x10
    path.write_bytes(content)


def overwrite(text: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(text) and None


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        pytest.param("fields.nc", Path.unlink, id="no-fields"),
        pytest.param("fields.nc", overwrite("not a NetCDF file"), id="fields-are-text"),
        pytest.param("fields.nc", cut_in_half, id="fields-cut"),
        pytest.param("fields.nc", flip_a_picture, id="fields-bit-turned"),
        pytest.param("run.json", Path.unlink, id="no-run"),
        pytest.param("run.json", cut_in_half, id="run-cut"),
        pytest.param("run.json", overwrite(""), id="run-empty"),
        pytest.param("run.json", overwrite("[]"), id="run-is-a-list"),
        pytest.param("run.json", overwrite("{}"), id="run-without-keys"),
        pytest.param("run.json", overwrite('{"schema": "labrig-run/9"}'), id="run-of-the-future"),
    ],
)
def test_report_of_damaged_results_is_refused(
    result_copy: Path, complaint: Complaint, file: str, damage: Callable[[Path], None]
) -> None:
    damage(result_copy / file)
    assert str(result_copy) in complaint("report", result_copy, code=3)
    assert not list(result_copy.rglob("*.html"))


def test_report_of_sound_results_is_written(result_copy: Path, command: Callable[..., Any]) -> None:
    said = command("report", result_copy, "--json")
    assert (said.code, said.err) == (0, "")
    assert Path(json.loads(said.out)["report"]).suffix == ".html"
    # the function must outlive the import of a module that may bear its name
    assert callable(labrig.report)


def test_report_of_a_session_without_results_says_what_to_do(
    small_session: Path, complaint: Complaint
) -> None:
    assert "labrig analyse" in complaint("report", small_session, code=3)


def test_analyse_prints_json(
    small_session: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    said = command("analyse", small_session, "--out", tmp_path, "--json")
    assert (said.code, said.err) == (0, "")
    run = json.loads(said.out)
    # measured 0.298, 0.135 and 0.414: the light that keeps the stripes is taken for single
    # scattering, and a coarse Monte Carlo adds its noise
    for name, truth, atol in (
        ("sigma_t_per_mm", 0.3, 0.006),
        ("sigma_s_per_mm", 0.15, 0.02),
        ("g", 0.3, 0.15),
    ):
        assert run[name]["value"] == pytest.approx(truth, abs=atol)
        assert 0.0 < run[name]["std"] < 0.01
    assert run["scale_c"]["value"] > 100.0 * run["scale_c"]["std"] > 0.0
    assert (run["model"]["geometry"], run["model"]["phase"]) == ("flatland", "hg-plane")
    assert run["model"]["meaning"].startswith("effective parameters of a plane")
    assert run["quality"]["saturated_fraction"] == 0.0
    assert abs(run["quality"]["closure"]["mean"]) < 1e-3  # measured 6e-5
    assert set(run["seconds"]) >= {"linearise", "rectify", "separate", "attenuate", "invert"}
    assert run["provenance"]["session_header_sha256"]
    assert run["session"]["path"] == str(small_session)
    assert json.loads((Path(run["path"]) / "run.json").read_text())["id"] == run["id"]


FIELDS = {
    "x": ("x",),
    "y": ("y",),
    "row": ("row",),
    "col": ("col",),
    "theta": ("theta",),
    "bounce": ("bounce",),
    "scattered_bounce": ("scattered_bounce",),
    "single_depth": ("single_depth",),
    "white_depth": ("white_depth",),
    "fluence": ("bounce", "y", "x"),
    "light_field": ("scattered_bounce", "y", "x", "theta"),
    **dict.fromkeys(("single", "multiple", "residual", "lit", "remainder"), ("y", "x")),
    **{name: (name,) for name in ("wave_depth", "period", "wavenumber", "profile_g")},
    "profile_chi2": ("profile_g",),
    "single_share": ("period", "wave_depth"),
    **{f"stripe_wave{what}": ("period", "wave_depth") for what in ("", "_std", "_fit")},
    **{f"white_wave{what}": ("wavenumber", "wave_depth") for what in ("", "_std", "_fit")},
    **{
        f"{name}_image": ("row", "col")
        for name in ("captured", "single", "multiple", "white", "closure")
    },
    **{f"{name}_variance_image": ("row", "col") for name in ("single", "multiple")},
    **{
        f"{light}_{name}": (f"{light}_depth",)
        for light in ("single", "white")
        for name in ("profile", "profile_std", "profile_fit")
    },
}


def test_fields_hold_what_is_documented(small_result: labrig.Result) -> None:
    with h5netcdf.File(small_result.path / "fields.nc", "r") as file:
        assert {name: v.dimensions for name, v in file.variables.items()} == FIELDS
        for name, variable in file.variables.items():
            assert variable.attrs["units"], name
            assert variable.attrs["long_name"], name
        assert file.attrs["length_unit"] == "mm"
        assert (file.dimensions["row"].size, file.dimensions["col"].size) == (120, 150)
        assert file.dimensions["bounce"].size == file.dimensions["scattered_bounce"].size + 1
        assert float(file.attrs["scale_c"]) == small_result.run["scale_c"]["value"]
    for name in ("single_image", "multiple_image", "fluence", "light_field"):
        assert np.isfinite(small_result.fields[name].values).all(), name


def test_fields_of_a_separation_lie_on_the_pixels(small_session: Path, tmp_path: Path) -> None:
    result = labrig.analyse(small_session, until="separation", out=tmp_path)
    assert result.fields["single"].dims == ("y", "x")
    assert result.fields["single"].values.shape == (120, 150)
    np.testing.assert_allclose(np.diff(result.fields["x"].values), 0.2, rtol=1e-12)
    assert "fluence" not in result.fields
    assert "sigma_t_per_mm" not in result.run


@pytest.fixture
def reimported(
    small_session: Path, tmp_path: Path, write_manifest: Callable[..., Path]
) -> Callable[..., Path]:
    """Return ``reimported(**keys)``: the small session's pictures under another manifest."""

    def make(**keys: Any) -> Path:
        session = Session.open(small_session)
        frames = []
        for shot in session.shots:
            tifffile.imwrite(tmp_path / f"{shot['id']}.tif", session.read(shot["id"]))
            known = {key: shot[key] for key in ("role", "exposure_s", "shift", "shifts")}
            frame = {key: value for key, value in known.items() if value is not None}
            frames.append({"file": f"{shot['id']}.tif", **frame})
        assert len(frames) == N_SHOTS
        return labrig.import_session(write_manifest(tmp_path, frames, **keys), tmp_path / "out")

    return make


GEOMETRY = {"region_px": [21, 20, 150, 120]}
IN_MM = {
    "geometry": {**GEOMETRY, "mm_per_px": 0.2},
    "tank": {"depth_mm": 30, "width_mm": 24},
    "beam": {"from_mm": 7.2, "to_mm": 16.8},
    "stripes": {"period_px": 12},
    "projection": {"mm_per_px": 0.15, "origin_mm": -36.0, "blur_px": 0.5},
}


def test_imported_pictures_give_the_captured_sessions_answer(
    small_result: labrig.Result, reimported: Callable[..., Path]
) -> None:
    result = labrig.analyse(reimported(camera={**CAMERA, **NOISE}, **IN_MM))
    for name in ("sigma_t_per_mm", "sigma_s_per_mm", "g", "scale_c"):
        assert result.run[name] == small_result.run[name]


def test_camera_without_noise_figures_is_said(
    small_result: labrig.Result, reimported: Callable[..., Path]
) -> None:
    result = labrig.analyse(reimported(camera=CAMERA, **IN_MM))
    (note,) = (note for note in result.run["notes"] if "read noise" in note)
    assert "no variance map" in note
    assert "scatter of rows" in note
    assert np.isnan(result.fields["single_variance_image"].values).all()
    found = result.run["sigma_t_per_mm"]
    assert found["value"] == pytest.approx(small_result.run["sigma_t_per_mm"]["value"], rel=0.01)
    assert 0.0 < found["std"] < 0.01


def test_picture_without_a_scale_is_measured_in_px(
    reimported: Callable[..., Path], coarse: Path
) -> None:
    result = labrig.analyse(reimported(camera={**CAMERA, **NOISE}, geometry=GEOMETRY), coarse)
    assert result.run["length_unit"] == "px"
    assert not [name for name in result.run if name.endswith("_per_mm")]
    assert any("scale of the picture is unknown" in note for note in result.run["notes"])
    assert any("beam was measured" in note for note in result.run["notes"])
    # 0.3 / mm at 0.2 mm / px; measured 0.0592
    assert result.run["sigma_t_per_px"]["value"] == pytest.approx(0.06, rel=0.03)
    assert 0.0 < result.run["sigma_s_per_px"]["value"] < result.run["sigma_t_per_px"]["value"]


def test_headless_script_runs(
    tmp_path: Path, small_rig: Path, small_scene: Path, small_plan: Path
) -> None:
    script = ROOT / "docs" / "examples" / "headless.py"
    files = [small_rig, small_scene, small_plan]
    said = subprocess.run(
        [sys.executable, script, tmp_path / "out", *files],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        cwd=tmp_path,
        env={key: value for key, value in os.environ.items() if key != "DISPLAY"},
    )
    assert said.returncode == 0, said.stderr
    assert len(list((tmp_path / "out").rglob("SEAL.json"))) == 1
    assert len(list((tmp_path / "out").rglob("run.json"))) == 1
    assert list((tmp_path / "out").rglob("*.html"))


def test_r9_fields_are_the_same_to_every_reader(small_result: labrig.Result) -> None:
    with h5py.File(small_result.path / "fields.nc") as file:
        assert {*small_result.fields} <= {*file}
        for name, field in small_result.fields.items():
            np.testing.assert_array_equal(file[name][...], field.values)


def test_r9_fields_are_the_same_to_xarray(small_result: labrig.Result) -> None:
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(small_result.path / "fields.nc", engine="h5netcdf") as found:
        assert {*found.variables} == {*FIELDS}
        for name, field in small_result.fields.items():
            assert found[name].dims == field.dims
            assert found[name].attrs["units"] == field.unit
            np.testing.assert_array_equal(found[name].values, field.values)


def test_r9_fields_are_the_same_to_ncdump(small_result: labrig.Result) -> None:
    if shutil.which("ncdump") is None:
        pytest.skip("needs ncdump (netcdf-bin)")
    file = small_result.path / "fields.nc"
    for name in ("single_profile", "error_estimate", "bounce", "fluence"):
        if name not in small_result.fields:
            continue
        told = subprocess.run(
            ["ncdump", "-p", "9,17", "-v", name, str(file)],
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        numbers = told[told.index(f" {name} =", told.index("data:")) :].split("=")[1].split(";")[0]
        found = np.array([np.nan if n.strip() in "_NaN" else float(n) for n in numbers.split(",")])
        np.testing.assert_array_equal(found, small_result.fields[name].values.ravel())


def test_r14_results_alone_say_how_to_have_them_again(
    small_session: Path, tmp_path: Path, coarse: Path
) -> None:
    """Config, code, driver versions and calibration, and a rerun by them to the last bit."""
    first = labrig.analyse(small_session, coarse, out=tmp_path / "first")
    told = json.loads((first.path / "run.json").read_text())["provenance"]
    header = Session.open(small_session).header
    assert told["session_header_sha256"] == sha256_of(small_session / "session.json")
    assert told["code_sha256"] == code_digest()
    assert told["software"]["labrig"] == header["software"]["labrig"]
    assert told["devices"] == header["devices"]
    assert told["devices"]["camera"]["firmware"]
    assert told["calibration"] == {}
    again = labrig.analyse(
        small_session, Analysis.model_validate(told["config"]), out=tmp_path / "again"
    )
    scalars = {k: v for k, v in first.run.items() if k in ("sigma_t_per_mm", "sigma_s_per_mm", "g")}
    assert len(scalars) == 3
    for name in (*scalars, "scale_c", "quality", "provenance", "notes"):
        assert again.run[name] == first.run[name], name
    for name, field in first.fields.items():
        np.testing.assert_array_equal(again.fields[name].values, field.values)
