"""Plans expand to the same shots every time, and patterns are what they say."""

from itertools import pairwise

import numpy as np
import pytest

import labrig
from labrig.config import parse
from labrig.errors import ConfigError, PlanError
from labrig.models.plan import Shot
from labrig.patterns import draw
from labrig.plan import expand, stripes_of

FOLDER = labrig.config_folder()


@pytest.fixture(scope="module")
def expanded():
    plan = labrig.load_plan(FOLDER / "plans" / "six-shifts.yaml")
    return expand(plan, labrig.load_rig(FOLDER / "rigs" / "simulated.yaml"))


def test_every_set_is_taken_at_every_exposure_and_groups_hold_all_shifts(expanded):
    assert len(expanded.shots) == 3 * (6 + 4)
    assert len({shot.id for shot in expanded.shots}) == len(expanded.shots)
    assert expanded.shots[0].id == "stripes-e0-r0-p00"
    groups = {shot.group for shot in expanded.shots if shot.role == "stripes"}
    for group in groups:
        assert [s.shift for s in expanded.shots if s.group == group] == list(range(6))
    # the exposure changes as rarely as it can
    exposures = [shot.exposure_s for shot in expanded.shots]
    assert sum(a != b for a, b in pairwise(exposures)) == 2


def test_roles_follow_from_pattern_and_shutter(expanded):
    roles = {shot.set: shot.role for shot in expanded.shots}
    assert roles == {
        "stripes": "stripes",
        "white": "white",
        "black": "black",
        "ambient": "ambient",
        "dark": "dark",
    }


def test_the_digest_names_the_shots(expanded):
    again = expand(expanded.plan, labrig.load_rig(FOLDER / "rigs" / "simulated.yaml"))
    assert again.digest == expanded.digest
    longer = expanded.plan.model_copy(
        update={"exposures": expanded.plan.exposures.model_copy(update={"bracket_s": (0.1, 0.2)})}
    )
    rig = labrig.load_rig(FOLDER / "rigs" / "simulated.yaml")
    assert expand(longer, rig).digest != expanded.digest


def test_stripes_are_half_lit_shifted_and_add_up_to_white(expanded):
    pattern = stripes_of(expanded.plan)
    images = [draw(pattern, 4, 120, k).astype(int) for k in range(6)]
    assert images[0][0, :6].tolist() == [255] * 6
    assert images[0][0, 6:12].tolist() == [0] * 6
    for k in range(6):
        np.testing.assert_array_equal(images[k], np.roll(images[0], 2 * k, axis=1))
    np.testing.assert_array_equal(sum(images), 3 * 255)


def test_stripes_that_do_not_fit_the_projector_are_refused(expanded):
    pattern = stripes_of(expanded.plan)
    with pytest.raises(PlanError, match="do not repeat"):
        draw(pattern, 4, 20, 0)


def test_shots_read_back_as_they_were_written(expanded):
    shot = expanded.shots[3]
    assert parse(shot.model_dump(), Shot, source="here") == shot
    with pytest.raises(ConfigError, match="'extra' is unknown"):
        parse({**shot.model_dump(), "extra": 1}, Shot, source="here")


def test_a_plan_without_stripes_cannot_open_a_simulated_rig():
    plan = parse(
        {
            "schema": "labrig-plan/1",
            "name": "white only",
            "exposures": {"bracket_s": [0.1]},
            "sets": [{"id": "w", "pattern": {"kind": "uniform"}}],
        },
        labrig.Plan,
        source="here",
    )
    with pytest.raises(PlanError, match="0 kinds of stripes"):
        stripes_of(plan)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        (
            {"id": "s", "shutter": "covered", "pattern": {"kind": "stripes"}},
            "behind a covered lens",
        ),
        ({"id": "w", "pattern": {"kind": "uniform", "level": 128}}, "255"),
        ({"id": "o", "pattern": {"kind": False}}, "kind is false, a number or a word"),
    ],
)
def test_sets_that_mean_nothing_are_refused_in_one_line(entry, said):
    content = {
        "schema": "labrig-plan/1",
        "name": "odd",
        "exposures": {"bracket_s": [0.1]},
        "sets": [entry],
    }
    with pytest.raises(ConfigError, match=said) as caught:
        parse(content, labrig.Plan, source="here")
    assert "\n" not in str(caught.value)
