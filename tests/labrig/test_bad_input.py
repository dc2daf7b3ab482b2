"""Damaged or contradictory input: the command line says one line, what is wrong with which file."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import labrig
from labrig.errors import ConfigError
from labrig.session import SessionWriter

Counts = NDArray[np.uint16]
Complaint = Callable[..., str]

ROOT = Path(__file__).resolve().parents[2]
SHAPE = (60, 90)
CAMERA = {"bits": 12, "black_level_dn": 16, "white_level_dn": 4095}
NOISE = {"gain_dn_per_e": 0.28, "read_noise_e": 10.9}
N_SHOTS = 20  # of the small session: ten pictures at two exposures


def tank(shift: int | None = None, shifts: int = 6) -> Counts:
    """Return a tank under stripes, or under white light, with the counts of both its lights."""
    y, x = np.arange(SHAPE[0])[:, None], np.arange(SHAPE[1])[None, :]
    beam = (y >= 15) & (y < 45)
    lit = 1.0 if shift is None else (y / 10 - shift / shifts) % 1.0 < 0.5
    share = 1.0 if shift is None else 0.5
    single = 2000.0 * np.exp(-x / 30.0) * beam * lit
    return np.rint(16.0 + single + share * 500.0 * np.exp(-x / 50.0)).astype(np.uint16)


def series(n: int = 6, of: int | None = None) -> dict[str, Counts]:
    """Return the first ``n`` pictures of a series of shifts, by name."""
    return {f"stripes-{k}": tank(k, of or n) for k in range(n)}


def dark_level(level: float = 16.0) -> Counts:
    return np.full(SHAPE, level, dtype=np.uint16)


@pytest.fixture
def imported(tmp_path: Path, write_manifest: Callable[..., Path]) -> Callable[..., Path]:
    """Return ``imported(pictures, **keys)``: a session of pictures named role or role-shift."""

    def make(pictures: Mapping[str, Counts], *, shifts: int = 6, **keys: Any) -> Path:
        frames = []
        folder = tmp_path / "pictures"
        folder.mkdir(exist_ok=True)
        for name, picture in pictures.items():
            role, _, shift = name.partition("-")
            tifffile.imwrite(folder / f"{name}.tif", picture)
            frame: dict[str, Any] = {"file": f"{name}.tif", "role": role, "exposure_s": 0.1}
            frames.append(frame | ({"shift": int(shift), "shifts": shifts} if shift else {}))
        manifest = write_manifest(folder, frames, **{"camera": CAMERA, **keys})
        return labrig.import_session(manifest, tmp_path / "sessions")

    return make


def remove(frame: Path) -> None:
    frame.unlink()


def cut(frame: Path) -> None:
    frame.write_bytes(frame.read_bytes()[:-100])


def change(frame: Path) -> None:
    content = bytearray(frame.read_bytes())
    content[-1] ^= 0x10
    frame.write_bytes(content)


@pytest.mark.parametrize("damage", [remove, cut, change])
def test_damaged_frame_is_named(
    session_copy: Path,
    complaint: Complaint,
    command: Callable[..., Any],
    damage: Callable[[Path], None],
) -> None:
    damage(session_copy / "frames" / "stripes-e1-r0-p03.tif")
    assert "frames/stripes-e1-r0-p03.tif" in complaint("analyse", session_copy, code=3)
    assert not (session_copy / "results").exists()
    # what verify is asked for is a list, so it goes to standard output
    found = command("verify", session_copy)
    assert found.code == 3
    assert found.out.startswith("frames/stripes-e1-r0-p03.tif: ")
    assert found.err == ""
    listed = json.loads(command("verify", session_copy, "--json").out)
    assert [p["file"] for p in listed["problems"]] == ["frames/stripes-e1-r0-p03.tif"]


def test_whole_session_is_called_whole(small_session: Path, command: Callable[..., Any]) -> None:
    found = command("verify", small_session)
    assert (found.code, found.err) == (0, "")
    assert found.out.strip().endswith("whole")


@pytest.mark.parametrize("verb", ["verify", "analyse", "report"])
def test_folder_that_is_no_session_is_named(
    tmp_path: Path, complaint: Complaint, verb: str
) -> None:
    assert "nowhere" in complaint(verb, tmp_path / "nowhere", code=3)
    (tmp_path / "empty").mkdir()
    assert "empty" in complaint(verb, tmp_path / "empty", code=3)
    (tmp_path / "file").touch()
    assert "file" in complaint(verb, tmp_path / "file", code=3)


def test_session_without_shots_is_refused(session_copy: Path, complaint: Complaint) -> None:
    header = json.loads((session_copy / "session.json").read_bytes())
    (session_copy / "session.json").write_text(json.dumps({**header, "shots": []}))
    assert "session.json" in complaint("analyse", session_copy, code=3)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b'{"schema": NaN}'])
def test_header_that_is_no_json_object_is_named(
    session_copy: Path, complaint: Complaint, content: bytes
) -> None:
    (session_copy / "session.json").write_bytes(content)
    assert "session.json" in complaint("analyse", session_copy, code=3)


def test_interrupted_session_says_what_is_missing(tmp_path: Path, complaint: Complaint) -> None:
    path = hostile(tmp_path, shots(), keep=4)
    text = complaint("analyse", path)
    assert "3 of 7 shots are missing (shot-4 first)" in text


def shots() -> list[dict[str, Any]]:
    """Return the shots of a sound session: six shifts and white."""
    stripes = [
        {"id": f"shot-{k}", "set": "s", "role": "stripes", "group": "g", "exposure_s": 0.1}
        | {"shift": k, "shifts": 6}
        for k in range(6)
    ]
    white = {"id": "shot-w", "set": "w", "role": "white", "group": "w", "exposure_s": 0.1}
    return [*stripes, white]


def hostile(
    root: Path,
    planned: list[dict[str, Any]],
    *,
    setup: Any = None,
    keep: int | None = None,
    odd_shape: bool = False,
) -> Path:
    """Write a session whose every digest is right, whatever its header says."""
    header = {"setup": {"camera": CAMERA} if setup is None else setup, "shots": planned}
    with SessionWriter.create(root, "hostile", header) as writer:
        for number, shot in enumerate(planned[:keep]):
            picture = tank(number if number < 6 else None)
            writer.commit(shot["id"], 1, picture[: -1 if odd_shape and number == 2 else None], {})
    return writer.path


def test_sound_session_of_this_kind_is_analysed(
    tmp_path: Path, command: Callable[..., Any]
) -> None:
    assert command("analyse", hostile(tmp_path, shots()), "--until", "separation").code == 0


@pytest.mark.parametrize(
    ("setup", "said"),
    [
        pytest.param({"camera": CAMERA, "camear": {}}, "'camear' is unknown", id="unknown-key"),
        pytest.param(
            {"camera": CAMERA, "stripes": {"perod_px": 12}},
            "'stripes.perod_px' is unknown",
            id="unknown-key-inside",
        ),
        pytest.param({}, "'camera' is missing", id="empty"),
        pytest.param([], "setup", id="list"),
        pytest.param("camera", "setup", id="text"),
        pytest.param({"camera": {**CAMERA, "bits": 64}}, "'camera.bits'", id="64-bits"),
        pytest.param({"camera": {**CAMERA, "bits": 8}}, "camera", id="white-above-bits"),
        pytest.param(
            {"camera": CAMERA, "geometry": {"region_px": [50, 50, 900, 900]}},
            "region_px",
            id="region-outside",
        ),
    ],
)
def test_setup_that_cannot_be_used_is_refused(
    tmp_path: Path, complaint: Complaint, setup: Any, said: str
) -> None:
    assert said in complaint("analyse", hostile(tmp_path, shots(), setup=setup))


@pytest.mark.parametrize(
    ("number", "changed"),
    [
        pytest.param(6, {"role": "laser"}, id="unknown-role"),
        pytest.param(2, {"role": "laser"}, id="unknown-role-among-the-shifts"),
        pytest.param(6, {"role": None}, id="no-role"),
        pytest.param(6, {"role": ["white"]}, id="role-is-a-list"),
        pytest.param(6, {"colour": "red"}, id="unknown-key"),
        pytest.param(2, {"exposure_s": "long"}, id="exposure-is-text"),
        pytest.param(2, {"exposure_s": None}, id="no-exposure"),
        pytest.param(2, {"exposure_s": 0}, id="exposure-zero"),
        pytest.param(2, {"exposure_s": -0.1}, id="exposure-negative"),
        pytest.param(2, {"shift": None}, id="stripes-without-shift"),
        pytest.param(0, {"shifts": None}, id="stripes-without-shifts"),
        pytest.param(0, {"shift": "first"}, id="shift-is-text"),
        pytest.param(0, {"shifts": "six"}, id="shifts-is-text"),
        pytest.param(0, {"shifts": 0}, id="no-shifts"),
        pytest.param(2, {"shifts": 3}, id="two-numbers-of-shifts"),
        pytest.param(5, {"shift": 6}, id="shift-6-of-6"),
        pytest.param(5, {"shift": -1}, id="shift-negative"),
        pytest.param(6, {"shift": 1, "shifts": 6}, id="white-with-a-shift"),
    ],
)
def test_shot_that_cannot_be_used_is_refused(
    tmp_path: Path, complaint: Complaint, number: int, changed: dict[str, Any]
) -> None:
    planned = shots()
    planned[number] |= changed
    text = complaint("analyse", hostile(tmp_path, planned), "--until", "separation")
    assert planned[number]["id"] in text or "shift" in text


def test_shot_that_lacks_its_exposure_is_refused(tmp_path: Path, complaint: Complaint) -> None:
    planned = shots()
    del planned[3]["exposure_s"]
    assert "'shot-3'" in complaint("analyse", hostile(tmp_path, planned))


def test_pictures_of_two_sizes_are_refused(tmp_path: Path, complaint: Complaint) -> None:
    complaint("analyse", hostile(tmp_path, shots(), odd_shape=True), "--until", "separation")


@pytest.fixture
def small_files(small_plan: Path, small_rig: Path, small_scene: Path) -> dict[str, Path]:
    return {"plan": small_plan, "rig": small_rig, "scene": small_scene}


@pytest.mark.parametrize(
    ("kind", "old", "new", "said"),
    [
        ("plan", "shutter:", "shuter:", "'sets.4.shuter' is unknown"),
        ("plan", "shifts: 6", "shifts: 5", "shifts = 5 does not divide"),
        ("scene", "g: 0.3", "g: .nan", "'medium.g'"),
        ("scene", "g: 0.3", "g: 1.1", "g = 1.1"),
        ("scene", "sigma_t_per_mm: 0.3", "sigma_t_per_mm: -0.3", "sigma_t = -0.3"),
        ("scene", "depth_mm: 30", "depth_mm: 40", "30 x 24 mm"),
        ("rig", "rows: 160", "rows: 100", "region_px"),
        ("rig", "cols: 640", "cols: 20", "not the whole beam"),
        ("plan", "[0.05, 0.4]", "[0.05, 100.0]", "100.0 s"),
        ("plan", "axis: x", "axis: y", "axis"),
    ],
)
def test_capture_of_a_bad_file_is_refused(
    tmp_path: Path,
    small_files: dict[str, Path],
    complaint: Complaint,
    kind: str,
    old: str,
    new: str,
    said: str,
) -> None:
    files = dict(small_files)
    text = files[kind].read_text(encoding="utf-8")
    assert old in text
    files[kind] = tmp_path / f"edited-{kind}.yaml"
    files[kind].write_text(text.replace(old, new, 1), encoding="utf-8")
    out = tmp_path / "out"
    given = ["--rig", files["rig"], "--scene", files["scene"], "--out", out]
    assert said in complaint("capture", files["plan"], *given)
    assert not out.exists()


def test_analysis_file_with_an_unknown_key_is_refused(
    tmp_path: Path, small_session: Path, complaint: Complaint
) -> None:
    config = tmp_path / "analysis.yaml"
    config.write_text("schema: labrig-analysis/1\nseperation: auto\n")
    out = tmp_path / "out"
    text = complaint("analyse", small_session, "--config", config, "--out", out, code=2)
    assert f"{config}: key 'seperation' is unknown; did you mean 'separation'?" in text
    assert not out.exists()


def test_bracket_saturated_throughout_is_refused(
    imported: Callable[..., Path], complaint: Complaint
) -> None:
    bright = {name: np.full(SHAPE, 4095, dtype=np.uint16) for name in series()}
    assert "saturated" in complaint("analyse", imported(bright), code=2)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise", [NOISE, {}], ids=["noise-known", "noise-unknown"])
@pytest.mark.parametrize(
    "level_dn", [16.0, 18.0], ids=["black-level-right", "black-level-off-by-2"]
)
def test_dark_pictures_give_no_parameters(
    imported: Callable[..., Path],
    coarse: Path,
    complaint: Complaint,
    level_dn: float,
    noise: dict[str, float],
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    pictures = {
        name: np.clip(np.rint(rng.normal(level_dn, 3.05, (120, 150))), 0, 4095).astype(np.uint16)
        for name in [*series(), "white"]
    }
    path = imported(pictures, camera={**CAMERA, **noise})
    complaint("analyse", path, "--config", coarse, code=2)


def test_missing_shift_is_named(
    tmp_path: Path, imported: Callable[..., Path], complaint: Complaint
) -> None:
    planned = shots()
    del planned[3]
    assert "shift 3 of 6 is missing" in complaint("analyse", hostile(tmp_path, planned))
    pictures = series()
    del pictures["stripes-3"]
    with pytest.raises(ConfigError, match="shift 3 of 6 is missing"):
        imported(pictures)


def test_edited_header_is_not_analysed(session_copy: Path, complaint: Complaint) -> None:
    header = session_copy / "session.json"
    header.write_text(header.read_text("utf-8").replace("0.05", "0.06"), encoding="utf-8")
    assert "session.json" in complaint("analyse", session_copy, code=3)


def test_seal_that_proves_nothing_is_not_taken_for_one(
    session_copy: Path, complaint: Complaint
) -> None:
    (session_copy / "SEAL.json").write_text("{}", encoding="utf-8")
    assert "SEAL.json" in complaint("analyse", session_copy, code=3)


def test_three_shifts_are_too_few_for_the_harmonic(
    tmp_path: Path, imported: Callable[..., Path], complaint: Complaint
) -> None:
    config = tmp_path / "analysis.yaml"
    config.write_text("schema: labrig-analysis/1\nseparation: harmonic\n")
    path = imported(series(3), shifts=3)
    assert "3 shifts" in complaint("analyse", path, "--config", config, code=2)


def test_pattern_that_is_not_known_is_refused(
    tmp_path: Path, imported: Callable[..., Path], complaint: Complaint
) -> None:
    config = tmp_path / "analysis.yaml"
    config.write_text("schema: labrig-analysis/1\nseparation: known-pattern\n")
    assert "projection" in complaint("analyse", imported(series()), "--config", config, code=2)


def test_bright_dark_frame_is_named(imported: Callable[..., Path], complaint: Complaint) -> None:
    text = complaint("analyse", imported({**series(), "dark": dark_level(2000)}))
    assert "dark-e0-r0" in text
    assert "2000 DN" in text


@pytest.mark.parametrize(
    "keys",
    [
        {"tank": {"depth_mm": 45, "width_mm": 30}},
        {"beam": {"from_mm": 7.5, "to_mm": 22.5}},
        {"projection": {"mm_per_px": 0.15, "origin_mm": 0.0}},
    ],
)
def test_lengths_in_mm_without_a_scale_are_refused(
    imported: Callable[..., Path], complaint: Complaint, keys: dict[str, Any]
) -> None:
    assert "geometry.mm_per_px" in complaint("analyse", imported(series(), **keys))


def test_session_without_stripes_is_refused(
    imported: Callable[..., Path], complaint: Complaint
) -> None:
    assert "stripe" in complaint("analyse", imported({"white": tank()}))


def test_tank_lit_from_the_other_side_is_refused(
    imported: Callable[..., Path], complaint: Complaint
) -> None:
    path = imported({**series(), "white": tank()}, geometry={"lit_side": "right"})
    assert "lit_side" in complaint("analyse", path, code=2)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["analyze"], "analyze"),
        (["verify", "--frob", "x"], "--frob"),
        (["analyse"], "SESSION"),
        (["analyse", "x", "--until", "nowhere"], "nowhere"),
        (["capture", "plan.yaml"], "--rig"),
        (["schema", "plans"], "plans"),
        (["report", "x", "y"], "y"),
    ],
)
def test_command_that_is_not_understood_is_refused(
    complaint: Complaint, arguments: list[str], said: str
) -> None:
    assert said.lower() in complaint(*arguments, code=2).lower()


@pytest.mark.parametrize("kind", ["plan", "rig", "scene", "analysis", "import"])
def test_schema_is_printed_as_json(command: Callable[..., Any], kind: str) -> None:
    said = command("schema", kind)
    assert (said.code, said.err) == (0, "")
    assert json.loads(said.out)["properties"]["schema"]["const"] == f"labrig-{kind}/1"


def test_results_that_cannot_be_written_are_refused(
    session_copy: Path, small_session: Path, complaint: Complaint
) -> None:
    (session_copy / "results").touch()
    text = complaint("analyse", session_copy, "--until", "separation", code=4)
    assert str(session_copy / "results") in text
    assert "--out" in text
    out = session_copy / "results" / "deeper"
    assert str(out) in complaint("analyse", small_session, "--out", out, code=4)


def test_session_that_is_read_only_asks_for_another_place(
    session_copy: Path, tmp_path: Path, complaint: Complaint, command: Callable[..., Any]
) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write to read-only folders")
    session_copy.chmod(0o555)
    try:
        assert "--out" in complaint("analyse", session_copy, "--until", "separation", code=4)
        said = command("analyse", session_copy, "--until", "separation", "--out", tmp_path / "out")
        assert said.code == 0
    finally:
        session_copy.chmod(0o755)
