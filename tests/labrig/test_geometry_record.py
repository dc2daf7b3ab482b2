"""What records of geometry and projector change in an analysis: millimetres, face, beam, gamma."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from frames import frame

import labrig
from calibration.geometry import Board
from calibration.projector import ProjectorGamma
from labrig.config import parse
from labrig.errors import AnalysisRefusedError
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.session import Session
from labrig.steps.corrections import Corrections, Projected, gather, shone
from labrig.steps.linearise import linearise
from labrig.steps.rectify import rectify

ManifestWriter = Callable[..., Path]


def board_frames(tmp_path: Path) -> list[dict[str, Any]]:
    """Three views of the board by a lens without distortion, the first square on: 0.375 mm/px."""
    board = Board()
    drawn = board.draw(3.0).astype(np.uint16) * 12 + 400
    frames = []
    for k, (left, top, tilt) in enumerate(((40, 30, 0.0), (20, 50, 0.3), (60, 20, -0.3))):
        # a homography of a camera of 400 px focal length at 150 mm; the first view is square on
        turn, _ = cv2.Rodrigues(np.array([tilt, -0.7 * tilt, 0.1 * k]))
        place = np.array([(left - 160) * 0.375, (top - 120) * 0.375, 150.0 + 10.0 * k])
        matrix = np.array([[400.0, 0, 159.5], [0, 400.0, 119.5], [0, 0, 1.0]])
        plane = matrix @ np.column_stack([turn[:, 0], turn[:, 1], place])
        scale = np.array([[1 / 3.0, 0, 1 / 6.0], [0, 1 / 3.0, 1 / 6.0], [0, 0, 1.0]])
        seen = cv2.warpPerspective(
            cv2.GaussianBlur(drawn, (0, 0), 0.6), plane @ scale, (320, 240), borderValue=2800.0
        )
        frames.append(frame(tmp_path, f"v{k}.tif", seen, "board", 0.1))
    return frames


def test_a_geometry_record_brings_pictures_to_even_millimetres(
    tmp_path: Path, write_manifest: ManifestWriter
) -> None:
    """Boards seen square on by a lens without distortion: mm are px times a known scale."""
    frames = board_frames(tmp_path)
    session = labrig.import_session(write_manifest(tmp_path, frames), tmp_path / "s")
    record = labrig.calibrate("geometry", session)
    found = labrig.read_calibration(record)
    # 150 mm over 400 px is 0.375; measured 0.3752
    assert found.quantities["mm_per_px"].value == pytest.approx(0.375, rel=0.005)
    pictures = []
    x = np.arange(320)[None, :]
    for k in range(6):
        counts = 1000.0 + 500.0 * np.cos(2 * np.pi * (x / 16.0 - k / 6.0)) + np.zeros((240, 320))
        pictures.append(frame(tmp_path, f"s{k}.tif", counts, "stripes", 0.1, shift=k, shifts=6))
    pictures.append(frame(tmp_path, "w.tif", np.full((240, 320), 2000.0), "white", 0.1))
    keys = {
        "stripes": {"profile": "sinusoid"},
        "geometry": {"region_px": [40, 30, 200, 150]},
        "calibration": {"geometry": str(record)},
    }
    manifest = write_manifest(
        tmp_path / "b", [{**p, "file": f"../{p['file']}"} for p in pictures], **keys
    )
    result = labrig.analyse(labrig.import_session(manifest, tmp_path / "s"), until="separation")
    assert result.run["length_unit"] == "mm"
    # 200 px of 0.375 mm; the region keeps its place and size
    assert result.fields["x"].values[-1] == pytest.approx(75.0, rel=0.01)
    single = result.fields["single"].values
    # a stripe's amplitude of 500 DN in 0.1 s, twice; measured -1.9 %: the resampling's blur
    assert np.nanmedian(single) == pytest.approx(1.0e4, rel=0.03)


def slanted_light(slope: float) -> np.ndarray:
    """Light from column 50 on, 60 rows high at the face, going down by ``slope``, (240, 320)."""
    y, x = np.mgrid[0.0:240.0, 0.0:320.0] + 0.5
    lit = np.clip(30.5 - np.abs(y - 120.0 - slope * (x - 50.0)), 0.0, 1.0)
    return np.asarray(np.where(x > 50.0, 3000.0 * np.exp(-(x - 50.0) / 150.0) * lit, 0.0))


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_entry_face_and_beam_of_a_geometry_record_are_the_defaults_of_an_analysis(
    tmp_path: Path, write_manifest: ManifestWriter, side: str
) -> None:
    seen = {"left": lambda p: p, "right": lambda p: p[:, ::-1]}
    upright = side in seen
    light = slanted_light(0.1) if upright else slanted_light(0.1)[:, :240]
    shape = (240, 320)
    if not upright:  # what is left to right is turned to be top to bottom
        turned = light.T if side == "top" else light.T[::-1]
        light = np.zeros(shape)
        light[:, :240] = turned
    else:
        light = seen[side](light)
    geometry = {"geometry": {"lit_side": side}}
    white = frame(tmp_path, "w.tif", 400.0 + light, "white", 0.1)
    black = frame(tmp_path, "k.tif", np.full(shape, 400.0), "black", 0.1)
    manifest = write_manifest(tmp_path, [*board_frames(tmp_path), white, black], **geometry)
    record = labrig.calibrate("geometry", labrig.import_session(manifest, tmp_path / "s"))
    stripes = [
        frame(tmp_path, f"s{k}.tif", 400.0 + 0.5 * light, "stripes", 0.1, shift=k, shifts=4)
        for k in range(4)
    ]
    keys = {**geometry, "calibration": {"geometry": str(record)}}
    frames = [{**f, "file": f"../{f['file']}"} for f in (*stripes, white, black)]
    session = Session.open(
        labrig.import_session(write_manifest(tmp_path / "b", frames, **keys), tmp_path / "s")
    )
    setup = parse(session.header["setup"], Setup, source="setup")
    known = gather(session, setup, Analysis.model_validate({"schema": "labrig-analysis/1"}))
    pictures = rectify(linearise(session, setup, known), session, setup, known)
    # atan 0.1; measured 5.692 to 5.729
    assert pictures.beam_angle_deg == pytest.approx(5.711, abs=0.05)
    # the first column is lit: the region begins at the face
    assert pictures.white is not None
    first = np.nanmax(pictures.white[:, :2], axis=0)
    assert first.min() > 0.8 * np.nanmax(pictures.white)
    assert pictures.unit == "mm"
    wrong = setup.model_copy(
        update={"geometry": setup.geometry.model_copy(update={"lit_side": "up"})}
    )
    with pytest.raises(AnalysisRefusedError, match=f"entry face on the {side}"):
        rectify(linearise(session, setup, known), session, wrong, known)


def test_grey_stripes_shine_by_the_projectors_gamma_and_black_and_white_need_none() -> None:
    levels = np.linspace(0.0, 1.0, 11)
    gamma = ProjectorGamma(levels=levels, light=levels**2.0, exponent=2.0, residual=0.0)
    projected = Projected(position_px={}, transfer={}, contrast=None, gamma=gamma)
    camera = {"bits": 12, "black_level_dn": 16, "white_level_dn": 4095}
    grey = {"low": 0.2, "high": 0.9, "levels": (0.2, 0.9)}
    setup = Setup.model_validate({"camera": camera, "stripes": grey})
    unknown = Corrections(camera=setup.camera.record())
    lit, _ = shone(setup, replace(unknown, projected=projected))
    assert lit.stripes is not None
    assert (lit.stripes.low, lit.stripes.high) == pytest.approx((0.04, 0.81))
    same, told = shone(setup, unknown)
    assert same == setup
    assert "gamma of the projector is unknown" in told.notes[0]
    plain = Setup.model_validate({"camera": camera, "stripes": {}})
    assert shone(plain, unknown) == (plain, unknown)
