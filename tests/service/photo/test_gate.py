"""Every bad input that concerns bytes gets its own answer, and every odd good one its photo."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import io
import subprocess
import time

import numpy as np
import pytest
from PIL import Image

from service.errors import (
    AnimatedImage,
    AvatarError,
    BadAspect,
    CorruptImage,
    EmptyFile,
    TooComplex,
    TooManyBytes,
    TooManyPixels,
    TooSmallImage,
    UnreadableInput,
    UnsupportedFormat,
)
from service.photo import gate
from service.photo.container import open_container, readable_formats
from service.photo.gate import read_photo
from service.photo.limits import Limits
from service.photo.photo import Photo
from tests.service.photo import badimages as bad

PICTURE = bad.picture()


def test_lossless_photo_comes_back_unchanged() -> None:
    data = bad.save(PICTURE, "PNG")
    photo = read_photo(data)
    assert np.array_equal(photo.pixels, PICTURE)
    assert photo.pixels.dtype == np.uint8
    assert photo.size == (96, 80)
    assert photo.sha256 == hashlib.sha256(data).hexdigest()
    assert photo.warnings == ()
    assert photo.focal_35mm is None


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("JPEG", {"quality": 95, "subsampling": 0}),
        ("JPEG", {"quality": 95, "progressive": True}),
        ("WEBP", {"quality": 95}),
        ("WEBP", {"lossless": True}),
        ("PNG", {"compress_level": 0}),
    ],
)
def test_each_format_is_read(kind: str, options: dict[str, object]) -> None:
    photo = read_photo(bad.save(PICTURE, kind, **options))
    assert np.abs(photo.pixels.astype(int) - PICTURE).mean() < 4
    assert photo.warnings == ()


def test_empty_file() -> None:
    with pytest.raises(EmptyFile, match=f"{', '.join(readable_formats())} are accepted"):
        read_photo(b"")


def test_formats_that_are_accepted_are_those_that_can_be_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    """One list: an empty file was told of fewer formats than a file of another one."""
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name == "pillow_heif" or find(name))
    assert readable_formats() == ("JPEG", "PNG", "WebP", "HEIC")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pillow_heif" else find(name))
    assert readable_formats() == ("JPEG", "PNG", "WebP")


@pytest.mark.parametrize("name", bad.NOT_IMAGES)
def test_other_formats_are_named_and_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "run_decoder", _must_not_run)
    with pytest.raises(UnsupportedFormat, match=f"{', '.join(readable_formats())} are accepted") as caught:
        read_photo(bad.NOT_IMAGES[name])
    assert caught.value.extra["looks_like"]


def test_too_many_bytes() -> None:
    with pytest.raises(TooManyBytes, match="1001 bytes; at most 1000"):
        read_photo(bytes(1001), Limits(max_bytes=1000))


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("JPEG", {}),
        ("JPEG", {"progressive": True}),
        ("JPEG", {"restart_marker_rows": 1}),
        ("PNG", {}),
        ("WEBP", {}),
        ("WEBP", {"lossless": True}),
    ],
)
def test_cut_at_every_percent(kind: str, options: dict[str, object]) -> None:
    data = bad.save(PICTURE, kind, **options)
    for percent in range(1, 100):
        with pytest.raises((CorruptImage, UnsupportedFormat)):
            read_photo(data[: len(data) * percent // 100])
    with pytest.raises(CorruptImage):
        read_photo(data[:-1])


def test_pixels_cut_off_inside_a_sound_container() -> None:
    """The container walk passes these; only the decoder can notice."""
    whole = bad.png(PICTURE, 2)
    start = whole.index(b"IDAT") + 4
    body = whole[start : whole.index(b"IEND") - 8]
    cut = whole[: start - 8] + bad.chunk(b"IDAT", body[: len(body) // 2]) + bad.chunk(b"IEND", b"")
    with pytest.raises(CorruptImage, match="pixels could not be decoded"):
        read_photo(cut)


@pytest.mark.parametrize("data", [bad.png_header(65_500, 65_500), bad.jpeg_header(65_500, 65_500), bad.png_bomb()])
def test_header_of_a_giant(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "run_decoder", _must_not_run)
    assert len(data) < 250_000
    start = time.process_time()
    with pytest.raises(TooManyPixels, match=r"65500|30000"):
        read_photo(data)
    assert time.process_time() - start < 0.1


@pytest.mark.parametrize(
    ("size", "error"),
    [((1, 1), TooSmallImage), ((32, 32), TooSmallImage), ((63, 200), TooSmallImage), ((20_000, 10), BadAspect)],
)
@pytest.mark.parametrize("header", [bad.png_header, bad.jpeg_header])
def test_sizes_out_of_range(size: tuple[int, int], error: type[Exception], header: object) -> None:
    assert callable(header)
    with pytest.raises(error, match=f"{size[0]} x {size[1]}"):
        read_photo(header(*size))


def test_zero_size() -> None:
    with pytest.raises(CorruptImage, match="0 x 10"):
        read_photo(bad.png_header(0, 10))


def test_packed_metadata_bombs() -> None:
    """A profile has to be unpacked; text is left out as it is."""
    with pytest.raises(CorruptImage):
        read_photo(bad.text_bomb(b"iCCP"))
    for kind in (b"zTXt", b"iTXt"):
        assert len(open_container(bad.text_bomb(kind), Limits()).payload) < 30_000  # a hundred thousand came
        assert read_photo(bad.text_bomb(kind)).warnings == ()


def test_hundreds_of_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "run_decoder", _must_not_run)
    with pytest.raises(TooComplex, match="more than 100 scans"):
        read_photo(bad.many_scans(600))


def test_palette_with_transparency() -> None:
    index = np.arange(96 * 80).reshape(80, 96, 1) % 3
    colours = bad.chunk(b"PLTE", bytes((255, 0, 0, 0, 255, 0, 0, 0, 255)))
    photo = read_photo(bad.png(index, 3, before=colours + bad.chunk(b"tRNS", bytes((0, 255, 255)))))
    expected = np.array([[128, 128, 128], [0, 255, 0], [0, 0, 255]])[index[..., 0]]
    assert np.array_equal(photo.pixels, expected)
    assert "transparent" in photo.warnings


def test_grey_with_alpha() -> None:
    rng = np.random.default_rng(0)
    samples = rng.integers(0, 256, (80, 96, 2))
    grey, alpha = samples[..., 0], samples[..., 1] / 255
    photo = read_photo(bad.png(samples, 4))
    expected = grey * alpha + 128 * (1 - alpha)
    assert np.abs(photo.pixels[..., 0] - expected).max() <= 1
    assert "transparent" in photo.warnings


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_grey_photo_keeps_its_pixels_and_says_so(kind: str) -> None:
    photo = read_photo(bad.save(Image.fromarray(PICTURE).convert("L"), kind))
    assert photo.pixels.shape == (80, 96, 3)
    assert (photo.pixels == photo.pixels[..., :1]).all()
    assert photo.warnings == ("no-colour",)


@pytest.mark.parametrize("data", [bad.apng(3), bad.webp_animation()])
def test_animation_is_never_silently_its_first_frame(data: bytes) -> None:
    with pytest.raises(AnimatedImage, match="3 frames"):
        read_photo(data)


def test_first_of_several_images_in_one_file() -> None:
    first, second = Image.fromarray(PICTURE), Image.fromarray(255 - PICTURE)
    mpo = bad.save(first, "MPO", save_all=True, append_images=[second])
    alone = read_photo(bad.save(first, "JPEG"))
    photo = read_photo(mpo)
    assert np.array_equal(photo.pixels, alone.pixels)
    assert photo.warnings == ("extra-images-ignored",)
    tail = read_photo(bad.save(first, "JPEG") + bad.save(second, "JPEG"))
    assert np.array_equal(tail.pixels, alone.pixels)
    assert tail.warnings == ("extra-images-ignored",)


def stored_as(upright: bad.Pixels, orientation: int) -> bad.Pixels:
    """How a camera stores the upright image for each EXIF orientation (Exif 3.0, tag 0x0112)."""
    turned = {
        1: upright,
        2: upright[:, ::-1],
        3: upright[::-1, ::-1],
        4: upright[::-1],
        5: upright.swapaxes(0, 1),
        6: upright.swapaxes(0, 1)[::-1],
        7: upright[::-1, ::-1].swapaxes(0, 1),
        8: upright.swapaxes(0, 1)[:, ::-1],
    }
    return np.ascontiguousarray(turned[orientation])


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("order", [">", "<"])
def test_orientation_is_undone(orientation: int, order: str) -> None:
    stored, tiff = stored_as(PICTURE, orientation), bad.exif(order, orientation, focal=35)
    kind = "PNG" if order == ">" else "WEBP"
    photo = read_photo(bad.save(stored, kind, lossless=True, exif=tiff))
    assert np.array_equal(photo.pixels, PICTURE)
    assert photo.focal_35mm == 35
    assert photo.warnings == ()


@pytest.mark.parametrize(
    "tiff",
    [
        bad.exif(orientation=99),
        bad.exif(orientation=0),
        b"II*\0",
        b"II*\0\xff\xff\xff\x7f",
        b"MM\0*\0\0\0\x08\xff\xff",
        b"\0" * 100,
        bad.exif()[:20],
    ],
)
def test_broken_exif_is_ignored(tiff: bytes) -> None:
    data = bad.save(PICTURE, "JPEG")
    photo = read_photo(bad.with_exif(data, tiff))
    assert np.array_equal(photo.pixels, read_photo(data).pixels)
    assert photo.warnings == ()


def test_metadata_goes_no_further() -> None:
    data = bad.save(PICTURE, "JPEG")
    marked = bad.insert(
        data,
        bad.segment(0xE1, b"Exif\0\0" + bad.exif() + b"GPS 52.5200 13.4050"),
        bad.segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + b"x" * 64_000),
        bad.segment(0xED, b"Photoshop 3.0\0" + b"8BIM\xff\xff\xff" * 50),
        bad.segment(0xFE, b"secret comment"),
    )
    photo = read_photo(marked)
    assert np.array_equal(photo.pixels, read_photo(data).pixels)
    known = ["pixels", "focal_35mm", "sha256", "warnings", "steps"]
    assert [field.name for field in dataclasses.fields(Photo)] == known
    payload = open_container(marked, Limits()).payload
    for secret in (b"xap", b"8BIM", b"secret"):
        assert secret not in payload, "the decoder sees no metadata but the first EXIF segment"
    exif = bad.segment(0xE1, b"Exif\0\0" + bad.exif(focal=35).ljust(60_000, b"x"))
    assert open_container(bad.insert(data, exif, exif, exif), Limits()).payload == bad.insert(data, exif)


def test_huge_profile_is_ignored_with_a_warning() -> None:
    profile = bad.matrix_profile(bad.P3_PRIMARIES, 2.2) + bytes(5_000_000)
    assert read_photo(bad.with_icc(bad.save(PICTURE, "JPEG"), profile)).warnings == ("icc-ignored",)


@pytest.mark.parametrize(
    "polyglot",
    [
        lambda data: data + b"PK\x03\x04" + bytes(200) + b"PK\x05\x06" + bytes(18),
        lambda data: bad.insert(data, bad.segment(0xFE, b"*/alert(1);/*")),
        lambda data: bad.insert(data, bad.segment(0xFE, b"<?php system($_GET['c']); ?>")),
        lambda data: data + b"<script>alert(1)</script>",
    ],
)
def test_polyglots_are_only_images(polyglot: object) -> None:
    assert callable(polyglot)
    data = bad.save(PICTURE, "JPEG")
    assert np.array_equal(read_photo(polyglot(data)).pixels, read_photo(data).pixels)


def test_bad_input_is_refused_at_the_rate_of_a_flood() -> None:
    cases = [*bad.NOT_IMAGES.values(), bad.png_header(65_500, 65_500), bad.save(PICTURE, "JPEG")[:-10]]
    start = time.process_time()
    for data in cases:
        with pytest.raises(UnreadableInput):
            read_photo(data)
    assert len(cases) / (time.process_time() - start) > 200


def _must_not_run(*_: object) -> None:
    raise AssertionError("a decoder was started for bytes that the header alone condemns")


HEADER_ONLY = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(100)


def heic(image: bad.Pixels, **options: object) -> bytes:
    pillow_heif = pytest.importorskip("pillow_heif")
    buffer = io.BytesIO()
    pillow_heif.from_pillow(Image.fromarray(image)).save(buffer, quality=95, **options)
    return buffer.getvalue()


def test_heic_without_its_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pillow_heif" else find(name))
    with pytest.raises(UnsupportedFormat, match="install the extra 'heic'") as caught:
        read_photo(HEADER_ONLY)
    assert caught.value.extra == {"extra": "heic"}


def test_heic_is_read() -> None:
    picture = bad.picture(128, 96)
    photo = read_photo(heic(picture, exif=bad.exif(focal=26)))
    assert photo.size == (128, 96)
    assert np.abs(photo.pixels.astype(int) - picture).mean() < 4
    assert photo.focal_35mm == 26
    assert photo.warnings == ()


def test_limits_hold_before_heic_is_decoded() -> None:
    with pytest.raises(TooManyPixels, match="256 x 128"):
        read_photo(heic(bad.picture(256, 128)), Limits(max_side=200))


def test_cut_and_damaged_heic() -> None:
    data = heic(bad.picture(128, 96))
    for percent in range(1, 100, 12):
        with pytest.raises(UnreadableInput):
            read_photo(data[: len(data) * percent // 100])
    with pytest.raises(CorruptImage):
        read_photo(HEADER_ONLY)


def test_moving_heic() -> None:
    with pytest.raises(AnimatedImage):
        read_photo(HEADER_ONLY.replace(b"ftypheic", b"ftyphevc"))


def test_transparent_pixels_show_one_grey() -> None:
    rgba = np.dstack([PICTURE, np.full(PICTURE.shape[:2], 255, np.uint8)])
    rgba[:40, :, 3] = 0
    for kind in ("PNG", "WEBP"):
        photo = read_photo(bad.save(Image.fromarray(rgba), kind, lossless=True))
        assert (photo.pixels[:40] == 128).all()
        assert np.array_equal(photo.pixels[40:], PICTURE[40:])
        assert photo.warnings == ("transparent",)


@pytest.mark.parametrize("profile", [b"", b"x" * 10, bytes(500), bad.matrix_profile(bad.P3_PRIMARIES, 2.2)[:300]])
def test_broken_profile_is_ignored_with_a_warning(profile: bytes) -> None:
    data = bad.save(PICTURE, "JPEG")
    broken = bad.with_icc(data, profile) if profile else bad.insert(data, bad.segment(0xE2, b"ICC_PROFILE\0\2\5abc"))
    photo = read_photo(broken)
    assert np.array_equal(photo.pixels, read_photo(data).pixels)
    assert photo.warnings == ("icc-ignored",)


def test_a_photo_that_is_good_is_not_refused_as_none_can_be_got_ready_for_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The service gets ready for the next photo before it answers for this one; the next one is told of the fault."""

    def full(*_: object, **__: object) -> None:
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(gate, "_AHEAD", [])
    monkeypatch.setattr(subprocess, "Popen", full)
    gate.expect_photo()
    with pytest.raises(AvatarError, match="could not be started"):
        read_photo(bad.save(PICTURE, "PNG"))


@pytest.mark.parametrize("killed", [False, True])
def test_a_process_that_was_started_ahead_decodes_one_photo(killed: bool) -> None:
    gate.expect_photo()
    gate.expect_photo()  # one waits at a time: a server asks after each photo
    ((process, _),) = gate._AHEAD
    if killed:
        process.kill()
        process.wait()
    data = bad.save(PICTURE, "PNG")
    assert np.array_equal(read_photo(data).pixels, PICTURE)
    assert not gate._AHEAD
    assert process.returncode == (-9 if killed else 0)
