"""Pictures taken elsewhere: they become a session count by count, or nothing is written."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

import labrig
from labrig.errors import ConfigError
from labrig.session import Session, verify

SHAPE = (24, 32)
EIGHT_BITS = {"bits": 8, "black_level_dn": 0, "white_level_dn": 255}
SIXTEEN_BITS = {"bits": 16, "black_level_dn": 0, "white_level_dn": 65535}

Counts = NDArray[np.uint16]


def counts(bits: int, seed: int = 1) -> Counts:
    """Return a picture that holds the lowest and the highest count of its bits."""
    picture = np.random.default_rng(seed).integers(0, 2**bits, SHAPE, dtype=np.uint16)
    picture.flat[:2] = 0, 2**bits - 1
    return picture


def save_by_pillow(path: Path, picture: Counts) -> None:
    Image.fromarray(picture).save(path)


def save_8_bit(path: Path, picture: Counts) -> None:
    Image.fromarray(picture.astype(np.uint8)).save(path)


def save_with_palette(path: Path, picture: Counts) -> None:
    """Save indices into a palette of falling greys: the index of a pixel is not its count."""
    image = Image.frombytes("P", picture.shape[::-1], (255 - picture).astype(np.uint8).tobytes())
    image.putpalette([255 - index for index in range(256) for _ in range(3)])
    image.save(path)


def save_equal_colours(path: Path, picture: Counts) -> None:
    Image.fromarray(np.repeat(picture.astype(np.uint8)[..., None], 3, axis=2)).save(path)


def save_tiff_8_bit(path: Path, picture: Counts) -> None:
    tifffile.imwrite(path, picture.astype(np.uint8))


def save_tiff_zlib(path: Path, picture: Counts) -> None:
    tifffile.imwrite(path, picture, compression="zlib")


def save_tiff_big_endian(path: Path, picture: Counts) -> None:
    tifffile.imwrite(path, picture, byteorder=">")


@pytest.fixture
def white(tmp_path: Path, write_manifest: Callable[..., Path]) -> Callable[..., Path]:
    """Return ``white(*files, **keys)``: a manifest of white frames in the test's folder."""

    def write(*files: str, **keys: Any) -> Path:
        frames = [{"file": file, "role": "white", "exposure_s": 1.0} for file in files]
        return write_manifest(tmp_path, keys.pop("frames", frames), **keys)

    return write


@pytest.fixture
def refusal(tmp_path: Path) -> Callable[[Path], str]:
    """Return the one line that refuses a manifest; it names it, and nothing was written."""

    def of(manifest: Path) -> str:
        out = tmp_path / "out"
        with pytest.raises(ConfigError) as caught:
            labrig.import_session(manifest, out)
        assert not list(out.rglob("*"))
        text = str(caught.value)
        assert text.startswith(f"{manifest}: ")
        assert "\n" not in text
        return text

    return of


@pytest.mark.parametrize(
    ("name", "bits", "save"),
    [
        pytest.param("a.png", 8, save_8_bit, id="png-8"),
        pytest.param("a.png", 8, save_with_palette, id="png-palette"),
        pytest.param("a.png", 8, save_equal_colours, id="png-three-equal-colours"),
        pytest.param("a.png", 16, save_by_pillow, id="png-16"),
        pytest.param("a.tif", 8, save_tiff_8_bit, id="tiff-8"),
        pytest.param("a.tiff", 16, tifffile.imwrite, id="tiff-16"),
        pytest.param("A.TIF", 16, tifffile.imwrite, id="tiff-in-capitals"),
        pytest.param("a.tif", 16, save_tiff_zlib, id="tiff-compressed"),
        pytest.param("a.tif", 16, save_tiff_big_endian, id="tiff-big-endian"),
        pytest.param("a.bmp", 8, save_8_bit, id="bmp-grey-palette"),
        pytest.param("a.bmp", 8, save_with_palette, id="bmp-other-palette"),
    ],
)
def test_counts_come_through_unchanged(
    tmp_path: Path,
    white: Callable[..., Path],
    name: str,
    bits: int,
    save: Callable[[Path, Counts], None],
) -> None:
    picture = counts(bits)
    save(tmp_path / name, picture)
    camera = EIGHT_BITS if bits == 8 else SIXTEEN_BITS
    path = labrig.import_session(white(name, camera=camera), tmp_path / "out")
    session = Session.open(path)
    kept = session.read("white-e0-r0")
    assert kept.dtype == np.uint16
    np.testing.assert_array_equal(kept, picture)
    assert verify(path) == []
    details = session.frames["white-e0-r0"].details
    assert details["source"] == name
    assert details["source_sha256"] == hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()


def test_shots_are_named_by_role_exposure_repeat_and_shift(
    tmp_path: Path, write_manifest: Callable[..., Path]
) -> None:
    (tmp_path / "pictures").mkdir()
    frames = [
        {"file": f"pictures/s{shift}-{exposure_s}.tif", "role": "stripes", "shift": shift}
        | {"shifts": 2, "exposure_s": exposure_s}
        for exposure_s in (0.4, 0.1)
        for shift in (0, 1)
    ]
    frames += [{"file": f"pictures/w{k}.tif", "role": "white", "exposure_s": 0.1} for k in (0, 1)]
    for number, frame in enumerate(frames):
        tifffile.imwrite(tmp_path / str(frame["file"]), counts(12, seed=number))
    told: list[tuple[int, int]] = []
    path = labrig.import_session(
        write_manifest(tmp_path, frames),
        tmp_path / "out",
        progress=lambda done, total: told.append((done, total)),
    )
    session = Session.open(path)
    assert [shot["id"] for shot in session.shots] == [
        "stripes-e1-r0-p00",
        "stripes-e1-r0-p01",
        "stripes-e0-r0-p00",
        "stripes-e0-r0-p01",
        "white-e0-r0",
        "white-e0-r1",
    ]
    for number, shot in enumerate(session.shots):
        np.testing.assert_array_equal(session.read(shot["id"]), counts(12, seed=number))
    assert told == [(done, 6) for done in range(1, 7)]
    assert session.sealed
    assert verify(path) == []


def test_picture_of_another_size_is_refused(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str]
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", counts(12))
    tifffile.imwrite(tmp_path / "b.tif", counts(12)[:-1])
    text = refusal(white("a.tif", "b.tif"))
    assert "frame b.tif is 32 x 23 px" in text


def test_missing_file_is_named(white: Callable[..., Path], refusal: Callable[[Path], str]) -> None:
    assert "frame no.tif does not exist" in refusal(white("no.tif"))
    assert "frame no.png does not exist" in refusal(white("no.png"))


def test_folder_is_no_picture(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str]
) -> None:
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "folder.tif").mkdir()
    assert "frame folder.png" in refusal(white("folder.png"))
    assert "frame folder.tif" in refusal(white("folder.tif"))


@pytest.mark.parametrize(
    ("name", "save"),
    [
        pytest.param("a.tif", tifffile.imwrite, id="tiff"),
        pytest.param("A.TIF", tifffile.imwrite, id="tiff-in-capitals"),
        pytest.param("a.tif", save_tiff_zlib, id="tiff-compressed"),
        pytest.param("a.png", save_8_bit, id="png-8"),
        pytest.param("a.png", save_by_pillow, id="png-16"),
        pytest.param("a.bmp", save_8_bit, id="bmp"),
    ],
)
def test_picture_cut_anywhere_is_refused_or_whole(
    tmp_path: Path,
    white: Callable[..., Path],
    refusal: Callable[[Path], str],
    name: str,
    save: Callable[[Path, Counts], None],
) -> None:
    picture = counts(8)
    save(tmp_path / name, picture)
    content = (tmp_path / name).read_bytes()
    manifest = white(name)
    # each byte of the header, which holds the tags, then one in 40 of the pixels; the last 16 of
    # a PNG are checksum and end mark: without them every pixel is still there
    for length in [*range(260), *range(260, len(content) - 16, 40)]:
        (tmp_path / name).write_bytes(content[:length])
        assert f"frame {name}" in refusal(manifest), f"cut to {length} bytes"


def test_png_that_does_not_fit_its_checksum_is_refused(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str]
) -> None:
    save_by_pillow(tmp_path / "a.png", counts(12))
    content = (tmp_path / "a.png").read_bytes()
    manifest = white("a.png")
    # the last pixels: a decoder may stop before the checksum behind them
    for at in range(len(content) - 80, len(content) - 16):
        damaged = bytearray(content)
        damaged[at] ^= 0x10
        (tmp_path / "a.png").write_bytes(damaged)
        assert "frame a.png" in refusal(manifest), f"bit turned in byte {at} of {len(content)}"


@pytest.mark.parametrize("name", ["a.tif", "A.TIF"])
def test_damaged_tiff_says_nothing_but_the_one_line(
    tmp_path: Path, white: Callable[..., Path], name: str
) -> None:
    tifffile.imwrite(tmp_path / name, counts(12))
    # cut within the tags, of which readers of pictures log and warn
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:200])
    # a process of its own: in this one pytest would catch what they say
    main = [sys.executable, "-c", "from labrig.cli import main; main()"]
    said = subprocess.run(
        [*main, "import", white(name), "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert said.returncode == 2
    assert said.stderr.startswith("labrig: ")
    assert len(said.stderr.splitlines()) == 1


@pytest.mark.parametrize("name", ["words.png", "words.tif", "words.bmp"])
def test_text_named_like_a_picture_is_refused(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str], name: str
) -> None:
    (tmp_path / name).write_text("This is a shopping list, not a picture.\n" * 20)
    assert f"frame {name}" in refusal(white(name))


@pytest.mark.parametrize("name", ["c.png", "c.tif", "c.bmp"])
def test_colour_picture_is_refused(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str], name: str
) -> None:
    colours = np.random.default_rng(3).integers(0, 256, (*SHAPE, 3), dtype=np.uint8)
    Image.fromarray(colours).save(tmp_path / name)
    assert f"frame {name} is in colour" in refusal(white(name))


def test_picture_of_another_kind_is_refused(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str]
) -> None:
    tifffile.imwrite(tmp_path / "float.tif", counts(12).astype(np.float32))
    tifffile.imwrite(tmp_path / "pages.tif", np.stack([counts(12)] * 5), photometric="minisblack")
    Image.fromarray(counts(8) > 100).save(tmp_path / "bit.png")
    assert "frame float.tif holds float32" in refusal(white("float.tif"))
    assert "frame pages.tif holds uint16 of shape (5, 24, 32)" in refusal(white("pages.tif"))
    assert "frame bit.png holds bool" in refusal(white("bit.png"))


def test_counts_above_the_declared_bits_are_refused(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str]
) -> None:
    # 12 bits shifted to the left, as many cameras deliver them
    tifffile.imwrite(tmp_path / "left.tif", counts(12) << 4)
    text = refusal(white("left.tif"))
    assert "frame left.tif holds 65520 DN" in text
    assert "camera.bits = 12" in text


def stripes(shifts: list[tuple[int, int]]) -> list[dict[str, Any]]:
    """Return frames of ``(shift, shifts)``, all of one file."""
    return [
        {"file": "a.tif", "role": "stripes", "exposure_s": 1.0, "shift": k, "shifts": n}
        for k, n in shifts
    ]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        pytest.param(
            {"frames": stripes([(0, 6), (1, 4)])}, "['4', '6'] shifts", id="two-numbers-of-shifts"
        ),
        pytest.param(
            {"frames": [{**stripes([(0, 6)])[0], "role": "white"}]},
            "a.tif: only role stripes has shift",
            id="shift-of-a-white-frame",
        ),
        pytest.param(
            {"frames": [{"file": "a.tif", "role": "stripes", "exposure_s": 1.0}]},
            "a.tif: role stripes needs shift and shifts",
            id="stripes-without-shift",
        ),
        pytest.param(
            {"frames": stripes([(6, 6)])}, "a.tif: shift 6 is not below shifts 6", id="shift-6-of-6"
        ),
        pytest.param({"frames": []}, "'frames'", id="no-frames"),
        pytest.param(
            {"geometry": {"region_px": [1, 0, 32, 24]}},
            "geometry.region_px [1, 0, 32, 24] leaves the picture of 32 x 24 px",
            id="region-outside",
        ),
        pytest.param(
            {"geometry": {"region_px": [0, 0, 32, 1]}}, "'geometry'", id="region-of-one-row"
        ),
    ],
)
def test_manifest_that_contradicts_itself_is_refused(
    tmp_path: Path,
    white: Callable[..., Path],
    refusal: Callable[[Path], str],
    keys: dict[str, Any],
    said: str,
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", counts(12))
    assert said in refusal(white("a.tif", **keys))


def test_out_that_is_a_file_is_named(
    tmp_path: Path, white: Callable[..., Path], command: Callable[..., Any]
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", counts(12))
    (tmp_path / "file").touch()
    said = command("import", white("a.tif"), "--out", tmp_path / "file")
    assert said.code != 0
    assert said.err.startswith("labrig: ")
    assert str(tmp_path / "file") in said.err
    assert len(said.err.splitlines()) == 1


def test_picture_that_may_not_be_read_is_named(
    tmp_path: Path, white: Callable[..., Path], refusal: Callable[[Path], str]
) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may read every file")
    tifffile.imwrite(tmp_path / "a.tif", counts(12))
    (tmp_path / "a.tif").chmod(0o000)
    assert "frame a.tif" in refusal(white("a.tif"))


def tank_light(shift: int, shifts: int) -> NDArray[np.float64]:
    """Return the tank under sinusoidal stripes, (60 across, 90 deep), counts; lit side left.

    Single and multiple scattering decay at different rates, and brighter on one side of the beam,
    so that no mirror image is equal to it.
    """
    y, x = np.arange(60)[:, None], np.arange(90)[None, :]
    single, multiple = tank_truth()
    lit = 0.5 + 0.5 * np.cos(2.0 * np.pi * (y / 9.3 + 0.01 * x - shift / shifts))
    return single * lit + 0.5 * multiple


def tank_truth() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.arange(60)[:, None], np.arange(90)[None, :]
    across = 1.0 + 0.5 * y / 60.0
    return 2000.0 * across * np.exp(-x / 40.0), 900.0 * across * np.exp(-x / 70.0)


def seen_from(side: str, tank: NDArray[Any]) -> NDArray[Any]:
    """Return the tank as a camera sees it whose picture is lit from a side; y is not mirrored."""
    return {
        "left": tank,
        "right": tank[:, ::-1],
        "top": tank.T,
        "bottom": tank.T[::-1],
    }[side]


@pytest.fixture(scope="module")
def separated(
    tmp_path_factory: pytest.TempPathFactory, write_manifest: Callable[..., Path]
) -> dict[str, labrig.Result]:
    """The same tank imported as seen from each side, and separated."""
    found = {}
    for side in ("left", "right", "top", "bottom"):
        folder = tmp_path_factory.mktemp(side)
        for shift in range(6):
            seen = seen_from(side, np.rint(tank_light(shift, 6)).astype(np.uint16))
            # what lies around the tank differs from side to side and must not matter
            frame = np.full((120, 130), 77 + shift, dtype=np.uint16)
            frame[7 : 7 + seen.shape[0], 11 : 11 + seen.shape[1]] = seen
            tifffile.imwrite(folder / f"s{shift}.tif", frame)
        height, width = seen.shape
        manifest = write_manifest(
            folder,
            [{**frame, "file": f"s{frame['shift']}.tif"} for frame in stripes_of_period(6)],
            geometry={"region_px": [11, 7, width, height], "lit_side": side, "mm_per_px": 0.5},
            tank={"depth_mm": 45, "width_mm": 30},
            stripes={"profile": "sinusoid"},
        )
        session = labrig.import_session(manifest, folder / "out")
        found[side] = labrig.analyse(session, until="separation")
    return found


def stripes_of_period(shifts: int) -> list[dict[str, Any]]:
    return stripes([(shift, shifts) for shift in range(shifts)])


@pytest.mark.parametrize("side", ["right", "top", "bottom"])
def test_separation_does_not_depend_on_the_lit_side(
    separated: dict[str, labrig.Result], side: str
) -> None:
    for name in ("single", "multiple", "captured", "x", "y"):
        np.testing.assert_array_equal(
            separated[side].fields[name].values, separated["left"].fields[name].values
        )


def test_separation_finds_the_light_the_pictures_were_made_of(
    separated: dict[str, labrig.Result],
) -> None:
    single, multiple = tank_truth()
    assert separated["left"].run["method"]["separation"] == "harmonic"
    # rounding to whole counts can do 4/3 and 7/3 at most; measured worst 1.15 and 1.23 counts
    np.testing.assert_allclose(separated["left"].fields["single"].values, single, atol=1.34)
    np.testing.assert_allclose(separated["left"].fields["multiple"].values, multiple, atol=2.34)
