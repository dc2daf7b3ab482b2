"""Records made of sessions by the command line, and used or refused by an analysis."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from frames import frame
from PIL import Image

import labrig
from calibration.errors import CalibrationError
from calibration.geometry import Board
from labrig.calibration_records import read_record
from labrig.cli import run
from labrig.errors import AnalysisRefusedError, ConfigError

SHAPE = (60, 80)
CAMERA = {"bits": 12, "black_level_dn": 16, "white_level_dn": 4095}
PAPER_CAMERA = {"bits": 8, "black_level_dn": 0, "white_level_dn": 255}
RAMP = (0.001, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6)
CONDITIONS = {"camera": "Test 1", "gain": "0 dB", "lens": "16 mm"}

ManifestWriter = Callable[..., Path]
Command = Callable[..., Any]


def lit(rate: float, exposure_s: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(rate * exposure_s / 0.28, SHAPE)
    return 16.0 + 0.28 * (electrons + rng.normal(0.0, 10.9, SHAPE))


@pytest.fixture(scope="module")
def camera_session(
    tmp_path_factory: pytest.TempPathFactory, write_manifest: ManifestWriter
) -> Path:
    """Pairs of flat and dark frames at eight exposures, the longest saturated."""
    folder = tmp_path_factory.mktemp("camera")
    frames = []
    for k, t in enumerate(RAMP):
        for j in (0, 1):
            seed = 10 * k + j
            frames.append(frame(folder, f"b{k}{j}.tif", lit(8000.0, t, seed), "flat", t))
            frames.append(frame(folder, f"d{k}{j}.tif", lit(0.0, t, 500 + seed), "dark", t))
    manifest = write_manifest(folder, frames, camera=CAMERA, conditions=CONDITIONS)
    return labrig.import_session(manifest, folder / "sessions")


@pytest.fixture(scope="module")
def records(camera_session: Path) -> dict[str, Path]:
    """Dark and photon-transfer records of the camera session, beside it."""
    return {kind: labrig.calibrate(kind, camera_session) for kind in ("dark", "photon-transfer")}


def stripes(folder: Path, write_manifest: ManifestWriter, **keys: Any) -> Path:
    """A session of six stripe pictures, white and black, at one exposure."""
    rng = np.random.default_rng(3)
    x = np.arange(SHAPE[1])
    frames = []
    for k in range(6):
        light = 1000.0 + 600.0 * np.cos(2 * np.pi * (x / 12.0 - k / 6.0))
        counts = 16.0 + light + rng.normal(0, 3.0, SHAPE)
        frames.append(frame(folder, f"s{k}.tif", counts, "stripes", 0.1, shift=k, shifts=6))
    frames.append(frame(folder, "w.tif", np.full(SHAPE, 2016.0), "white", 0.1))
    frames.append(frame(folder, "k.tif", np.full(SHAPE, 36.0), "black", 0.1))
    given = {"stripes": {"profile": "sinusoid"}, "conditions": CONDITIONS, "camera": CAMERA, **keys}
    return labrig.import_session(write_manifest(folder, frames, **given), folder / "sessions")


def test_photon_transfer_by_the_command_line_stands_beside_its_session(
    command: Command, camera_session: Path
) -> None:
    said = command("calibrate", "photon-transfer", camera_session, "--json")
    assert said.code == 0
    found = json.loads(said.out)
    path = Path(found["path"])
    assert path.parent == camera_session.parent
    # measured 0.2792 and 11.02, of pairs of 4800 px
    assert found["quantities"]["gain_dn_per_e"]["value"] == pytest.approx(0.28, rel=0.02)
    assert found["quantities"]["dark_noise_e"]["value"] == pytest.approx(10.9, rel=0.02)
    assert found["conditions"]["camera"] == "Test 1"
    text = (path / "record.yaml").read_text(encoding="utf-8")
    assert "gain_dn_per_e:\n    value: 0.2" in text
    page = (path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 1
    assert "<script" not in page
    assert "http" not in page
    assert (path / "figures" / "photon-transfer.pdf").is_file()


def test_a_table_is_printed_for_people(
    command: Command, camera_session: Path, tmp_path: Path
) -> None:
    said = command("calibrate", "dark", camera_session, "--out", tmp_path)
    assert said.code == 0
    assert "offset_dn" in said.out
    assert "record" in said.out


def test_flat_and_response_are_made_too(
    camera_session: Path, records: dict[str, Path], tmp_path: Path
) -> None:
    with pytest.raises(CalibrationError, match="half of the range"):
        labrig.calibrate("flat", camera_session, out=tmp_path)
    response = labrig.read_calibration(labrig.calibrate("response", camera_session, out=tmp_path))
    assert response.settings["response"] == "linear"
    # measured 0.0004
    assert response.quantities["linearity_rms"].value < 0.01


def test_an_analysis_uses_the_records_it_is_named(
    records: dict[str, Path], tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    session = stripes(tmp_path, write_manifest)
    plain = labrig.analyse(session, until="separation", out=tmp_path / "plain")
    assert np.isnan(plain.fields["single_variance"].values).all()
    file = tmp_path / "analysis.yaml"
    named = {kind: str(path) for kind, path in records.items()}
    file.write_text(json.dumps({"schema": "labrig-analysis/1", "calibration": named}))
    found = labrig.analyse(session, file, until="separation", out=tmp_path / "with")
    assert set(found.run["provenance"]["calibration"]) == {"dark", "photon-transfer"}
    assert any("photon-transfer record" in note for note in found.run["notes"])
    stated = np.sqrt(np.nanmean(found.fields["single_variance"].values))
    # K E of 1000 DN and the read noise: 17.0 DN a shot, 2/sqrt(3) of it in D, in 0.1 s; measured
    # 19.62 DN against 19.63
    assert stated == pytest.approx(17.0 * 2.0 / np.sqrt(3.0) / 0.1, rel=0.05)
    hot = labrig.read_calibration(records["dark"]).settings["hot_pixels"]
    assert int(np.isnan(found.fields["single"].values).sum()) == hot


def test_a_session_can_name_its_records_itself(
    records: dict[str, Path], tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    shutil.copytree(records["photon-transfer"], tmp_path / "gain")
    session = stripes(tmp_path, write_manifest, calibration={"photon-transfer": "gain"})
    found = labrig.analyse(session, until="separation")
    assert "photon-transfer" in found.run["provenance"]["calibration"]


@pytest.mark.parametrize(
    ("conditions", "kind", "said"),
    [
        ({**CONDITIONS, "gain": "12 dB"}, "dark", "gain was 0 dB and is 12 dB"),
        ({**CONDITIONS, "camera": "Other 2"}, "photon-transfer", "camera was Test 1"),
        (CONDITIONS, "flat", "it was named as flat"),
    ],
)
def test_records_that_do_not_hold_are_refused_in_one_line(
    records: dict[str, Path],
    tmp_path: Path,
    write_manifest: ManifestWriter,
    conditions: dict[str, str],
    kind: str,
    said: str,
) -> None:
    path = records["dark" if kind == "flat" else kind]
    session = stripes(
        tmp_path, write_manifest, conditions=conditions, calibration={kind: str(path)}
    )
    with pytest.raises(AnalysisRefusedError, match=said) as caught:
        labrig.analyse(session, until="separation")
    assert "\n" not in str(caught.value)


def test_what_was_not_noted_is_told_and_not_refused(
    records: dict[str, Path], tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    session = stripes(
        tmp_path,
        write_manifest,
        conditions={"camera": "Test 1"},
        calibration={"dark": str(records["dark"])},
    )
    found = labrig.analyse(session, until="separation")
    assert any("gain was 0 dB and is not noted" in note for note in found.run["notes"])


def test_damaged_and_missing_records_get_one_line(
    command: Command, records: dict[str, Path], tmp_path: Path
) -> None:
    copy = shutil.copytree(records["dark"], tmp_path / "dark")
    arrays = (copy / "arrays.nc").read_bytes()
    (copy / "arrays.nc").write_bytes(arrays[:-1] + b"?")
    for path in (copy, tmp_path / "nowhere"):
        said = command("report", path)
        assert said.code != 0
        assert said.err.count("\n") == 1
        assert "Traceback" not in said.err
    (copy / "arrays.nc").unlink()
    with pytest.raises(ConfigError, match="cannot be read"):
        labrig.read_calibration(copy)


def test_sessions_that_cannot_serve_get_one_line(
    command: Command, tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    session = stripes(tmp_path, write_manifest)
    for kind in ("dark", "flat", "photon-transfer", "response", "geometry"):
        said = command("calibrate", kind, session, "--out", tmp_path / kind)
        assert said.code == 2
        assert said.err.startswith("labrig: ")
        assert said.err.count("\n") == 1
        assert not (tmp_path / kind).exists()


def test_contrast_against_depth_is_measured_and_divided_out(
    tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    rng = np.random.default_rng(9)
    y = np.arange(SHAPE[0])[:, None]
    depth = np.arange(SHAPE[1]) + 0.5
    c1 = 0.55 * np.exp(-(((depth - 30.0) / 70.0) ** 2))
    frames = []
    for k in range(6):
        light = 2000.0 * (0.5 + c1 * np.cos(2 * np.pi * (y / 12.0 - k / 6.0)))
        counts = 16.0 + light + rng.normal(0.0, 3.0, SHAPE)
        frames.append(frame(tmp_path, f"s{k}.tif", counts, "stripes", 0.1, shift=k, shifts=6))
    frames.append(frame(tmp_path, "w.tif", np.full(SHAPE, 2016.0), "white", 0.1))
    frames.append(frame(tmp_path, "k.tif", np.full(SHAPE, 16.0), "black", 0.1))
    keys = {"camera": CAMERA, "stripes": {"profile": "square"}}
    session = labrig.import_session(write_manifest(tmp_path, frames, **keys), tmp_path / "s")
    record = labrig.calibrate("projector", session)
    file = tmp_path / "analysis.yaml"
    named = {"projector": str(record)}
    file.write_text(json.dumps({"schema": "labrig-analysis/1", "calibration": named}))
    found = labrig.analyse(session, file, until="separation")
    share = found.fields["single"].values / 2.0e4
    # the target is opaque: all of its light is direct. Measured worst column 0.6 %
    np.testing.assert_allclose(np.median(share, axis=0), 1.0, atol=0.015)
    assert not any("not calibrated" in note for note in found.run["notes"])


def test_board_is_drawn_in_true_size_and_found_again(command: Command, tmp_path: Path) -> None:
    said = command("calibrate", "board", "--out", tmp_path / "board", "--square-mm", 8)
    assert said.code == 0
    with Image.open(tmp_path / "board" / "board.png") as drawn:
        # nine squares of 8 mm and two margins of 10 mm, at 600 dpi
        assert drawn.width / drawn.info["dpi"][0] * 25.4 == pytest.approx(92.0, abs=0.05)
        picture = np.asarray(drawn.convert("L").resize((1100, 909)))
    assert labrig.draw_board(tmp_path / "again")[0].read_bytes().startswith(b"%PDF")
    pdf = (tmp_path / "board" / "board.pdf").read_bytes()
    box = pdf.split(b"/MediaBox [ 0 0 ")[1].split(b" ]")[0].split()
    assert float(box[0]) / 72.0 * 25.4 == pytest.approx(92.0, abs=0.05)
    detector = cv2.aruco.CharucoDetector(Board(square_mm=8.0).opencv())
    _, ids, _, _ = detector.detectBoard(picture)
    assert len(ids) == 48


@pytest.fixture(scope="module")
def paper(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Part of the pictures of a Grey code on paper: codes along x with inverses, white, black."""
    cut = tmp_path_factory.mktemp("paper")
    for number in (*range(20), 40, 41):
        taken = real_data / "procam_stripes" / "capture_0" / f"graycode_{number:02d}.png"
        with Image.open(taken) as picture:
            picture.crop((0, 100, 1280, 400)).save(cut / f"{number}.png")
    return cut


@pytest.fixture(scope="module")
def coded(paper: Path, write_manifest: ManifestWriter) -> Path:
    """The session of the whole code."""
    code = [
        paper_shot(paper, 2 * (9 - bit) + k, "grey-code", axis="x", bit=bit, polarity=polarity)
        for bit in range(10)
        for k, polarity in enumerate(("plain", "inverse"))
    ]
    frames = [*code, paper_shot(paper, 40, "white"), paper_shot(paper, 41, "black")]
    size = {"rows": 768, "cols": 1024}
    manifest = write_manifest(paper / "code", frames, camera=PAPER_CAMERA, projector=size)
    return labrig.import_session(manifest, paper / "sessions")


def paper_shot(paper: Path, number: int, role: str, **more: Any) -> dict[str, Any]:
    return {"file": str(paper / f"{number}.png"), "role": role, "exposure_s": 1.0, **more}


def paper_stripes(paper: Path, out: Path, bit: int, write: ManifestWriter, **keys: Any) -> Any:
    """Separate a bit of the code and its inverse; return run.json."""
    first = 2 * (9 - bit)
    frames = [
        *(paper_shot(paper, first + k, "stripes", shift=k, shifts=2) for k in (0, 1)),
        paper_shot(paper, 40, "white"),
        paper_shot(paper, 41, "black"),
    ]
    stripes = {"period_px": 4 * 2**bit, "offset_px": 2**bit}
    manifest = write(out / f"{bit}", frames, camera=PAPER_CAMERA, stripes=stripes, **keys)
    return labrig.analyse(labrig.import_session(manifest, out / "s"), until="separation").run


def test_grey_code_of_real_paper_makes_a_map_that_separates_its_finest_stripes(
    paper: Path, coded: Path, tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    record = labrig.calibrate("projector", coded, out=tmp_path)
    found = labrig.read_calibration(record)
    # measured 5.6 % and 0.315 px
    assert found.quantities["leak_median"].value == pytest.approx(0.055, abs=0.005)
    assert found.quantities["map_x_residual_px"].value < 0.35
    run = paper_stripes(paper, tmp_path, 0, write_manifest, calibration={"projector": str(record)})
    assert run["method"]["separation"] == "known-pattern"
    quality = run["quality"]
    # one shift is the other's inverse; measured -1.709 and -1.714 %, for stripe edges are masked
    assert quality["closure"]["mean"] == pytest.approx(quality["additivity"], abs=1e-3)
    # by extremes 0.42; measured 1.12
    assert quality["direct_share_median"] >= 0.9


def test_every_period_of_real_paper_closes_with_the_response_of_its_inverses(
    paper: Path, coded: Path, tmp_path: Path, write_manifest: ManifestWriter, command: Command
) -> None:
    said = command("calibrate", "response", coded, "--out", tmp_path, "--json")
    assert said.code == 0, said.err
    record = json.loads(said.out)
    assert record["settings"]["response"] == "fitted"
    assert record["quantities"]["power"]["value"] == pytest.approx(1.05, abs=0.02)  # measured 1.046
    arrays = read_record(Path(record["path"]))[1].arrays
    # one edge, of "period" 2048 on 1024 px, is no stripe
    stripes = arrays["pair_period"].values <= 1024.0
    worst = {
        name: np.abs(arrays[name].values[stripes]).max()
        for name in ("pair_closure", "pair_closure_fitted")
    }
    # each half of the picture with the response of the other; measured 0.51 % (0.24 % up to 512
    # px), without it 1.72 %
    assert worst["pair_closure_fitted"] <= 0.01
    assert worst["pair_closure"] > 0.015
    closures = [
        paper_stripes(paper, tmp_path / name, 1, write_manifest, **known)["quality"]["closure"]
        for name, known in (
            ("plain", {}),
            ("known", {"calibration": {"response": record["path"]}}),
        )
    ]
    # stripes of 8 px; measured -1.70 % and -0.23 %
    assert closures[0]["mean"] < -0.015
    assert abs(closures[1]["mean"]) <= 0.01


def inverses(folder: Path, write: ManifestWriter, *, power: float, lost: float) -> Path:
    """A session of six shifts on paper by an 8-bit camera; ``lost`` of their light goes astray."""
    rng = np.random.default_rng(5)
    x, white = np.arange(SHAPE[1]), np.linspace(0.4, 0.9, SHAPE[0])[:, None]
    lights = [
        0.5 * (1 - lost) * (1 + np.cos(2 * np.pi * (x / 12.0 - k / 6.0))) * white for k in range(6)
    ]
    frames = []
    for k, light in enumerate([*lights, white * np.ones(SHAPE), 0.02 * np.ones(SHAPE)]):
        more = {"shift": k, "shifts": 6} if k < 6 else {}
        role = "stripes" if k < 6 else ("white", "black")[k - 6]
        counts = 255.0 * (light + 0.02 * (k < 7)) ** power + rng.normal(0.0, 0.5, SHAPE)
        frames.append(frame(folder, f"{k}.tif", np.clip(counts, 0, 255), role, 0.1, **more))
    manifest = write(folder, frames, camera=PAPER_CAMERA, stripes={"period_px": 12})
    return labrig.import_session(manifest, folder / "s")


def test_shifts_half_a_period_apart_tell_a_linear_camera_from_a_bent_one(
    tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    for power, response in ((1.0, "linear"), (1.2, "fitted")):
        session = inverses(tmp_path / response, write_manifest, power=power, lost=0.0)
        found = labrig.read_calibration(labrig.calibrate("response", session))
        # measured 1.0000 and 1.1994
        assert found.quantities["power"].value == pytest.approx(power, abs=0.01)
        assert found.settings["response"] == response


def test_light_lost_in_stripes_of_a_linear_camera_is_no_response(
    tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    session = inverses(tmp_path, write_manifest, power=1.0, lost=0.1)
    with pytest.raises(CalibrationError, match="not the camera's response") as caught:
        labrig.calibrate("response", session)
    assert "\n" not in str(caught.value)


def test_help_names_every_kind(command: Command) -> None:
    said = command("calibrate", "--help")
    for kind in ("dark", "flat", "photon-transfer", "response", "geometry", "board", "projector"):
        assert kind in said.out
    assert run(["calibrate", "nonsense"]) == 2
