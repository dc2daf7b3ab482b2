"""What many tests need: a small rig with its session, a command line to call, real captures."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import labrig
from labrig.cli import run

ROOT = Path(__file__).resolve().parents[1]

RIG = """\
schema: labrig-rig/1
name: small
camera:
  driver: simulated
  rows: 160
  cols: 192
  bits: 12
  black_level_dn: 16
  white_level_dn: 4095
  gain_dn_per_e: 0.28
  read_noise_e: 10.9
  readout_s: 0.02
  seed: 1
projector:
  driver: simulated
  rows: 24
  cols: 640
  refresh_hz: 60
  latency_s: 0.03
  settle_s: 0.02
  black_level: 0.01
geometry: {mm_per_px: 0.2, region_px: [21, 20, 150, 120], lit_side: left}
projection: {mm_per_px: 0.15, origin_mm: -36.0, blur_px: 0.5}
"""

SCENE = """\
schema: labrig-scene/1
name: small
medium: {sigma_t_per_mm: 0.3, sigma_s_per_mm: 0.15, g: 0.3}
tank: {depth_mm: 30, width_mm: 24}
beam: {from_mm: 7.2, to_mm: 16.8}
light: {peak_e_per_s: 2.0e5, ambient_e_per_s: 300}
transport: {method: montecarlo, n_paths: 60000, cell_mm: 0.5, seed: 1}
"""

PLAN = """\
schema: labrig-plan/1
name: small
exposures: {bracket_s: [0.05, 0.4]}
sets:
  - {id: stripes, pattern: {kind: stripes, period_px: 12, shifts: 6, axis: x}}
  - {id: white, pattern: {kind: uniform, level: 255}}
  - {id: black, pattern: {kind: black}}
  - {id: ambient, pattern: {kind: lamp-off}}
  - {id: dark, pattern: {kind: lamp-off}, shutter: covered}
"""

Frames = Sequence[Mapping[str, Any]]
ManifestWriter = Callable[..., Path]


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What a command returned and printed."""

    code: int
    out: str
    err: str


@pytest.fixture(scope="session", autouse=True)
def _cache_of_this_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep computed light in a folder of this run, never in the user's home.

    The workers of a run share it, which is safe because a response is renamed into place when
    whole. Without workers the folder above belongs to all runs, and light that another version
    of the program computed must not be found.
    """
    base = tmp_path_factory.getbasetemp()
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LABRIG_CACHE", str(folder / "cache"))
        yield


@pytest.fixture(scope="session")
def _small_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    for name, text in (("rig", RIG), ("scene", SCENE), ("plan", PLAN)):
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def small_rig(_small_files: Path) -> Path:
    """A rig file: 192 x 160 px that see a tank of 30 x 24 mm in 150 x 120 px."""
    return _small_files / "rig.yaml"


@pytest.fixture(scope="session")
def small_scene(_small_files: Path) -> Path:
    """A scene file: albedo one half, nine mean free paths deep, 60 000 paths of light."""
    return _small_files / "scene.yaml"


@pytest.fixture(scope="session")
def small_plan(_small_files: Path) -> Path:
    """A plan file: six shifts, white, black, ambient and dark, at two exposures each."""
    return _small_files / "plan.yaml"


@pytest.fixture(scope="session")
def small_session(
    small_plan: Path,
    small_rig: Path,
    small_scene: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """The small plan, captured. Shared: write results elsewhere, and damage only a copy."""
    plan = labrig.load_plan(small_plan)
    with labrig.open_rig(small_rig, small_scene, plan) as rig:
        return labrig.capture(plan, rig, tmp_path_factory.mktemp("sessions"))


@pytest.fixture
def session_copy(small_session: Path, tmp_path: Path) -> Path:
    """A copy of the small session, to be damaged."""
    return shutil.copytree(small_session, tmp_path / "copy" / small_session.name)


@pytest.fixture(scope="session")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An analysis file for tests that ask no more of the solver than that it answers."""
    path = tmp_path_factory.mktemp("analysis") / "coarse.yaml"
    path.write_text(
        "schema: labrig-analysis/1\nn_theta: 32\nn_bounces: 4\nn_g: 3\ng_range: [-0.5, 0.7]\n"
    )
    return path


@pytest.fixture(scope="session")
def write_manifest() -> ManifestWriter:
    """Return ``write(folder, frames, **keys)``: an import manifest, 12 bits unless told."""

    def write(folder: Path, frames: Frames, **keys: Any) -> Path:
        content = {
            "schema": "labrig-import/1",
            "camera": {"bits": 12, "black_level_dn": 0, "white_level_dn": 4095},
            **keys,
            "frames": list(frames),
        }
        folder.mkdir(parents=True, exist_ok=True)
        manifest = folder / "manifest.yaml"
        # JSON is YAML, and the program's one reader of YAML is what is under test
        manifest.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
        return manifest

    return write


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Return ``command(*arguments)``: run the command line in this process."""

    def call(*arguments: object) -> Said:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return Said(code=code, out=said.out, err=said.err)

    return call


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real captures made by others, which are no part of the project."""
    given = os.environ.get("LABRIG_REAL_DATA")
    folder = Path(given) if given else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real captures: LABRIG_REAL_DATA is {given!r}, and {folder} is no folder")
    return folder
