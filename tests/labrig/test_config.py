"""Configuration files: what is read is right, and what is wrong is named by file and key."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

import labrig
from labrig.config import SCHEMAS, json_schema, load
from labrig.errors import ConfigError
from labrig.models.analysis import Analysis
from labrig.models.manifest import ImportManifest
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.models.series import Concentrations

BY_FOLDER: dict[str, type[Any]] = {
    "plans": Plan,
    "rigs": Rig,
    "scenes": Scene,
    "analyses": Analysis,
    "imports": ImportManifest,
    "series": Concentrations,
}
SHIPPED = sorted(labrig.config_folder().rglob("*.yaml"))

MANIFEST = """\
schema: labrig-import/1
camera: {bits: 12, black_level_dn: 0, white_level_dn: 4095}
stripes: {period_px: 12}
frames: [{file: a.png, role: white, exposure_s: 1.0}]
"""

Edited = Callable[[str, str, str], str]


@pytest.fixture
def message(
    small_plan: Path, small_rig: Path, small_scene: Path, tmp_path: Path
) -> Callable[[str, str, str], str]:
    """Return what is said of a small file in which one text was replaced by another."""
    texts = {
        "plan": small_plan.read_text(encoding="utf-8"),
        "rig": small_rig.read_text(encoding="utf-8"),
        "scene": small_scene.read_text(encoding="utf-8"),
        "import": MANIFEST,
    }

    def of(kind: str, old: str, new: str) -> str:
        assert old in texts[kind]
        return refusal(tmp_path, kind, texts[kind].replace(old, new, 1))

    return of


def refusal(folder: Path, kind: str, content: str | bytes) -> str:
    """Return the one line that refuses a file, which must name it."""
    path = folder / f"edited-{kind}.yaml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ConfigError) as caught:
        load(path, SCHEMAS[kind])
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("kind", "old", "new", "key", "near"),
    [
        ("plan", "exposures:", "exposure:", "exposure", "exposures"),
        ("scene", "g: 0.3", "gg: 0.3", "medium.gg", "g"),
        ("rig", "gain_dn_per_e", "gain_dn_per", "camera.gain_dn_per", "gain_dn_per_e"),
        ("plan", "shutter:", "shuter:", "sets.4.shuter", "shutter"),
        ("plan", "period_px:", "period:", "sets.0.pattern.period", "period_px"),
        ("plan", "level: 255", "levle: 255", "sets.1.pattern.levle", "level"),
        ("plan", "{kind: lamp-off}", "{kind: lamp-off, knd: 1}", "sets.3.pattern.knd", "kind"),
        ("import", "bits:", "bit:", "camera.bit", "bits"),
        ("import", "period_px:", "perod_px:", "stripes.perod_px", "period_px"),
        ("import", "role: white", "role: white, shft: 1", "frames.0.shft", "shift"),
    ],
)
def test_unknown_key_is_named_with_the_nearest_known_one(
    message: Edited, kind: str, old: str, new: str, key: str, near: str
) -> None:
    text = message(kind, old, new)
    assert f"{key!r} is unknown" in text
    assert f"did you mean {near!r}?" in text


@pytest.mark.parametrize("key", ["stripes", "uniform", "black", "lamp-off"])
def test_unknown_key_may_be_spelled_like_a_kind_of_pattern(message: Edited, key: str) -> None:
    assert f"{key!r} is unknown" in message("plan", "name: small", f"name: small\n{key}: 1")
    in_entry = message("plan", "shutter: covered", f"shutter: covered, {key}: 1")
    assert f"'sets.4.{key}' is unknown" in in_entry


@pytest.mark.parametrize(
    ("kind", "old", "key"),
    [
        ("plan", "name: small\n", "name"),
        ("plan", "schema: labrig-plan/1\n", "schema"),
        ("rig", "  bits: 12\n", "camera.bits"),
        ("scene", ", g: 0.3", "medium.g"),
        ("plan", "id: white, ", "sets.1.id"),
        ("plan", ", pattern: {kind: uniform, level: 255}", "sets.1.pattern"),
    ],
)
def test_missing_key_is_named(message: Edited, kind: str, old: str, key: str) -> None:
    assert f"{key!r} is missing" in message(kind, old, "")


@pytest.mark.parametrize("number", [".nan", ".inf", "-.inf", "nan", "1.0e999"])
@pytest.mark.parametrize(
    ("kind", "old", "key"),
    [
        ("scene", "sigma_t_per_mm: 0.3", "medium.sigma_t_per_mm"),
        ("scene", "g: 0.3", "medium.g"),
        ("scene", "to_mm: 16.8", "beam.to_mm"),
        ("scene", "depth_mm: 30", "tank.depth_mm"),
        ("rig", "read_noise_e: 10.9", "camera.read_noise_e"),
        ("rig", "origin_mm: -36.0", "projection.origin_mm"),
        ("plan", "[0.05, 0.4]", "exposures.bracket_s.1"),
    ],
)
def test_number_that_is_none_is_refused(
    message: Edited, kind: str, old: str, key: str, number: str
) -> None:
    value = f"[0.05, {number}]" if old.startswith("[") else f"{old.partition(':')[0]}: {number}"
    assert f"key {key!r}: " in message(kind, old, value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("g: 0.3", "g: 1.1", "g = 1.1"),
        ("g: 0.3", "g: -1.01", "g = -1.01"),
        ("sigma_t_per_mm: 0.3", "sigma_t_per_mm: -0.3", "sigma_t = -0.3"),
        ("sigma_t_per_mm: 0.3", "sigma_t_per_mm: 0", "sigma_t = 0"),
        ("sigma_s_per_mm: 0.15", "sigma_s_per_mm: 0.31", "sigma_s = 0.31"),
        ("sigma_s_per_mm: 0.15", "sigma_s_per_mm: -0.1", "sigma_s = -0.1"),
    ],
)
def test_unphysical_medium_is_refused_with_the_number_found(
    message: Edited, old: str, new: str, said: str
) -> None:
    text = message("scene", old, new)
    assert "key 'medium': " in text
    assert said in text


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("to_mm: 16.8", "to_mm: 24.2", "24.2"),
        ("from_mm: 7.2", "from_mm: -0.1", "-0.1"),
        ("from_mm: 7.2", "from_mm: 17.0", "17.0"),
        ("from_mm: 7.2", "from_mm: 16.8", "no width"),
        ("to_mm: 16.8", "to_mm: 16.8, angle_deg: 90", "angle_deg = 90"),
    ],
    ids=["above-the-tank", "below-the-tank", "reversed", "without-width", "along-the-face"],
)
def test_beam_that_cannot_enter_is_refused(message: Edited, old: str, new: str, said: str) -> None:
    text = message("scene", old, new)
    assert "beam" in text
    assert said in text


@pytest.mark.parametrize(
    ("kind", "old", "new", "said"),
    [
        ("plan", "shifts: 6", "shifts: 5", "shifts = 5 does not divide period_px = 12"),
        ("plan", "period_px: 12, shifts: 6", "period_px: 9, shifts: 3", "period_px = 9 is odd"),
        ("plan", "shifts: 6", "shifts: 1", "sets.0.pattern.shifts"),
        ("plan", "axis: x", "low: 255", "low = 255"),
        ("plan", "id: white", "id: stripes", "'stripes' is given twice"),
        ("plan", "id: white", "id: ../white", "sets.1.id"),
        ("plan", "kind: uniform", "kind: unifrom", "sets.1.pattern"),
        ("plan", "kind: uniform, ", "", "sets.1.pattern"),
        ("plan", "[0.05, 0.4]", "[0.05, 0.05]", "twice"),
        ("plan", "[0.05, 0.4]", "[]", "exposures.bracket_s"),
        ("plan", "[0.05, 0.4]", "[0.05, 0.0]", "exposures.bracket_s.1"),
        ("plan", "labrig-plan/1", "labrig-plan/2", "labrig-plan/1"),
        ("rig", "white_level_dn: 4095", "white_level_dn: 4096", "12-bit"),
        ("rig", "black_level_dn: 16", "black_level_dn: 4095", "black level"),
        ("rig", "[21, 20, 150, 120]", "[-1, 20, 150, 120]", "geometry"),
        ("rig", "lit_side: left", "lit_side: front", "geometry.lit_side"),
        ("import", "role: white", "role: laser", "frames.0.role"),
        ("import", "exposure_s: 1.0", "exposure_s: 0", "frames.0.exposure_s"),
    ],
)
def test_value_that_does_not_fit_is_named(
    message: Edited, kind: str, old: str, new: str, said: str
) -> None:
    assert said in message(kind, old, new)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        pytest.param("- 1\n- 2\n", "holds list", id="list"),
        pytest.param("just words\n", "holds str", id="text"),
        pytest.param("", "holds nothing", id="empty"),
        pytest.param("# only a comment\n", "holds nothing", id="comment"),
        pytest.param("name: [1, 2\nschema: x\n", "not valid YAML", id="broken"),
        pytest.param("\tname: x\n", "not valid YAML", id="tab"),
        pytest.param("name: a\x00b\n", "not valid YAML", id="control-character"),
        pytest.param("name: *nobody\n", "not valid YAML", id="alias-of-nothing"),
        pytest.param("[" * 5000, "not valid YAML", id="deep"),
        pytest.param("name: \xff\xfe\n".encode("latin-1"), "not UTF-8", id="latin-1"),
        pytest.param("name: x\n".encode("utf-16"), "not UTF-8", id="utf-16"),
    ],
)
def test_file_that_is_no_yaml_mapping_is_refused(
    tmp_path: Path, content: str | bytes, said: str
) -> None:
    assert said in refusal(tmp_path, "plan", content)


def test_python_tag_is_refused_and_not_run(tmp_path: Path) -> None:
    victim = tmp_path / "made-by-the-tag"
    text = refusal(tmp_path, "plan", f"!!python/object/apply:os.system ['touch {victim}']\n")
    assert "not valid YAML" in text
    assert not victim.exists()


def test_value_that_unfolds_is_not_printed_whole(tmp_path: Path) -> None:
    # five levels make 500 kB of a few lines; with ten the message would fill the memory
    levels = ["&a0 [x, x, x, x, x, x, x, x, x, x]"]
    levels += [f"&a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 5)]
    text = refusal(tmp_path, "import", MANIFEST + f"name: [{', '.join(levels)}]\n")
    assert "'name'" in text
    assert len(text) < 1000


def test_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=rf"^{re.escape(str(tmp_path / 'no.yaml'))}: .*No such"):
        labrig.load_plan(tmp_path / "no.yaml")
    with pytest.raises(ConfigError, match=rf"^{re.escape(str(tmp_path))}: .*directory"):
        labrig.load_plan(tmp_path)


def test_file_that_may_not_be_read_is_named(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may read every file")
    locked = tmp_path / "locked.yaml"
    locked.touch(mode=0o000)
    with pytest.raises(ConfigError, match="Permission denied"):
        labrig.load_plan(locked)


@pytest.mark.parametrize("kind", SCHEMAS)
def test_schema_is_json_and_mentions_every_key(kind: str) -> None:
    schema = json.loads(json.dumps(json_schema(kind), allow_nan=False))
    assert schema["type"] == "object"
    assert schema["additionalProperties"] is False
    model: type[BaseModel] = SCHEMAS[kind]
    keys = {field.alias or name for name, field in model.model_fields.items()}
    assert set(schema["properties"]) == keys
    assert schema["properties"]["schema"]["const"] == f"labrig-{kind}/1"


@pytest.mark.parametrize(
    ("kind", "inner"),
    [
        ("plan", {"bracket_s", "shutter", "period_px", "shifts", "level", "lamp-off"}),
        ("rig", {"gain_dn_per_e", "refresh_hz", "region_px", "blur_px"}),
        ("scene", {"sigma_t_per_mm", "depth_mm", "angle_deg", "peak_e_per_s", "n_paths"}),
        ("analysis", {"g_range", "hg-paper", "harmonic"}),
        ("import", {"exposure_s", "shift", "mm_per_px", "profile", "white_level_dn"}),
    ],
)
def test_schema_mentions_the_keys_inside(kind: str, inner: set[str]) -> None:
    text = json.dumps(json_schema(kind))
    assert {word for word in inner if f'"{word}"' not in text} == set()


def test_schema_of_an_unknown_kind_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="plan, rig, scene, analysis, import"):
        json_schema("plans")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_file_that_comes_with_the_program_loads(path: Path) -> None:
    loaded = load(path, BY_FOLDER[path.relative_to(labrig.config_folder()).parts[0]])
    assert loaded.model_dump(by_alias=True)["schema"].startswith("labrig-")


def test_files_come_with_the_program() -> None:
    assert {path.parent.name for path in SHIPPED} >= {"plans", "rigs", "scenes", "analyses"}


def test_what_was_read_is_frozen(small_plan: Path) -> None:
    plan = labrig.load_plan(small_plan)
    with pytest.raises(ValidationError, match="frozen"):
        plan.name = "other"


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("g_range", [0.8, -0.5], "g_range"),
        ("g_range", [-1.0, 0.5], "g_range"),
        ("depth_range_mm", [5.0, 5.0], "depth_range_mm"),
        ("n_theta", 66, "n_theta"),
        ("n_bounces", 1, "n_bounces"),
        ("separation", "harmonics", "separation"),
        ("cell_mm", 0.0, "cell_mm"),
    ],
)
def test_analysis_that_cannot_run_is_refused(
    tmp_path: Path, key: str, value: object, said: str
) -> None:
    content = json.dumps({"schema": "labrig-analysis/1", key: value})
    assert said in refusal(tmp_path, "analysis", content)
