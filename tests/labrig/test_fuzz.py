"""Damaged or hostile files: one clear line each, and nothing outside the folder."""

from __future__ import annotations

import json
import os
import shutil
import zlib
from functools import partial
from pathlib import Path

import pytest
import toy
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import labrig
from labrig.config import SCHEMAS, load
from labrig.errors import LabrigError, SessionError
from labrig.session import Session, verify
from labrig.session.recovery import reopen

# of each kind: plans, rigs, manifests, journals; `make torture` tries 2500
N = int(os.environ.get("LABRIG_FUZZ", "120"))
SETTINGS = settings(
    max_examples=N, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.floats(allow_nan=True),
    st.text(max_size=8),
    st.sampled_from(["../x", "!!python/object/apply:os.system", "a/b", "0o7", "1e400"]),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=6,
)


def paths_in(tree, prefix=()):
    """Every place in a nested mapping or list."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in items:
        yield (*prefix, key)
        if isinstance(value, dict | list):
            yield from paths_in(value, (*prefix, key))


def changed(tree, path, value):
    tree = json.loads(json.dumps(tree))
    here = tree
    for key in path[:-1]:
        here = here[key]
    here[path[-1]] = value
    return tree


def refusal(call) -> str | None:
    """What a call says in refusing; None if it does not. Any other error is a failure."""
    try:
        call()
    except LabrigError as error:
        return str(error)
    return None


MANIFEST = {
    "schema": "labrig-import/1",
    "camera": {"bits": 12, "black_level_dn": 0, "white_level_dn": 4095},
    "frames": [{"file": "a.png", "role": "stripes", "exposure_s": 0.1, "shift": 0, "shifts": 2}],
}


@pytest.mark.parametrize(
    ("kind", "good"), [("plan", toy.PLAN), ("rig", toy.RIG), ("import", MANIFEST)]
)
def test_configuration_file_is_read_or_refused_in_one_line(kind, good, tmp_path: Path) -> None:
    file = tmp_path / "f.yaml"
    places = list(paths_in(good))

    @SETTINGS
    @given(st.sampled_from(places), VALUES)
    def check(path, value) -> None:
        file.write_text(yaml.safe_dump(changed(good, path, value)), encoding="utf-8")
        said = refusal(lambda: load(file, SCHEMAS[kind]))
        assert said is None or ("\n" not in said and str(file) in said)

    check()
    assert [p.name for p in tmp_path.iterdir()] == ["f.yaml"]


def test_yaml_tags_run_nothing(tmp_path: Path) -> None:
    file, proof = tmp_path / "f.yaml", tmp_path / "proof"
    file.write_text(f'schema: !!python/object/apply:os.system ["touch {proof}"]\n')
    for kind, model in SCHEMAS.items():
        with pytest.raises(LabrigError, match="not valid YAML"):
            load(file, model)
        assert not proof.exists(), kind


def line_of(event: dict) -> bytes:
    body = json.dumps(event, sort_keys=True, separators=(",", ":"), allow_nan=True).encode()
    return body[:-1] + b',"crc32":"%08x"}\n' % zlib.crc32(body)


def test_journal_is_read_or_refused_in_one_line(tmp_path: Path) -> None:
    _, session = toy.capture(
        tmp_path / "in", {"kind": "drop", "shot": "stripes-e1-r0-p00", "times": 99}
    )
    path = session.path
    (path / "SEAL.json").unlink()
    lines = (path / "journal.jsonl").read_bytes().splitlines(keepends=True)
    events = [{k: v for k, v in json.loads(line).items() if k != "crc32"} for line in lines]
    keys = sorted({key for event in events for key in event})
    outside = sorted(p.name for p in tmp_path.iterdir())

    @SETTINGS
    @given(st.integers(0, len(lines) - 1), st.sampled_from(keys), VALUES, st.booleans())
    def check(at, key, value, fits) -> None:
        event = {**events[at], key: value}
        # with a fitting crc32, as a hostile sender would write it
        line = line_of(event) if fits else lines[at].replace(b'"', b"'", 1)
        (path / "journal.jsonl").write_bytes(b"".join([*lines[:at], line, *lines[at + 1 :]]))
        said = refusal(lambda: toy.read_all(path))
        assert said is None or "\n" not in said
        for problem in verify(path):
            assert "\n" not in problem.what

    check()
    assert sorted(p.name for p in tmp_path.iterdir()) == outside


@pytest.mark.parametrize(
    "hostile", ["frames", "quarantine", "journal.jsonl", "session.json", "session.lock"]
)
def test_hostile_links_lead_nowhere_on_resume(hostile, tmp_path: Path) -> None:
    _, session = toy.capture(
        tmp_path / "in", {"kind": "drop", "shot": "stripes-e1-r0-p00", "times": 99}
    )
    path, outside = session.path, tmp_path / "outside"
    (path / "SEAL.json").unlink()
    target = path / hostile
    if target.is_dir():
        shutil.copytree(target, outside)
        shutil.rmtree(target)
    else:
        shutil.copy(target, outside)
        target.unlink()
    target.symlink_to(outside)
    before = sorted((p.name, p.stat().st_mtime_ns) for p in [outside, *outside.glob("*")])
    with pytest.raises(SessionError):
        reopen(path)
    assert sorted((p.name, p.stat().st_mtime_ns) for p in [outside, *outside.glob("*")]) == before


def test_hostile_link_does_not_lead_results_outside(tmp_path: Path) -> None:
    _, session = toy.capture(tmp_path / "in")
    outside = tmp_path / "outside"
    outside.mkdir()
    (session.path / "results").symlink_to(outside)
    for act in (partial(labrig.analyse, until="separation"), labrig.report):
        with pytest.raises(SessionError, match="symbolic link"):
            act(session.path)
    assert list(outside.iterdir()) == []
    labrig.analyse(session.path, until="separation", out=tmp_path / "elsewhere")


def test_frame_that_claims_a_huge_size_is_not_read(tmp_path: Path) -> None:
    _, session = toy.capture(tmp_path)
    path = session.path
    (path / "SEAL.json").unlink()
    lines = (path / "journal.jsonl").read_bytes().splitlines(keepends=True)
    event = {k: v for k, v in json.loads(lines[2]).items() if k != "crc32"}
    event |= {"rows": 10**9, "cols": 10**9, "bytes": 10**19}
    (path / "journal.jsonl").write_bytes(b"".join([*lines[:2], line_of(event), *lines[3:]]))
    found = Session.open(path)
    with pytest.raises(SessionError, match="bytes"):
        found.read(event["shot"])
