"""Pictures of many formats, made here by the documents of each or by other software, and files of the archives."""

import gzip
import json
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from astropy.io import fits
from picture_bytes import isis_bytes, pds4_label, vicar_bytes, voyager_bytes
from PIL import Image
from scipy.spatial.transform import Rotation

from opnav_workbench.errors import ImageError
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.image.picture_files import picture_files

RNG = np.random.default_rng(24)
PIXELS = RNG.integers(3, 200, (12, 20))
KEYWORDS = KeywordMap()
MISSION = KeywordMap(
    exposure_s="EXP_MS",
    exposure_scale=1e-3,
    utc="START",
    time_reference="start",
    quaternion=("QA", "QX", "QY", "QZ"),
    quaternion_sense="camera_to_j2000",
    sun_position=("SX", "SY", "SZ"),
    sun_velocity=("VX", "VY", "VZ"),
    target="TARGET",
)
SIDECAR = {
    "utc": "2030-01-01T00:00:01.000",
    "exposure_s": 2.0,
    "attitude": [0.5, 0.5, -0.5, 0.5],
    "position_km": [1.5e8, 0.0, 0.0],
    "velocity_km_s": [0.0, 30.0, 1.0],
    "target": "MOON",
    "camera": {"gain": 2},
}


def error_of(path, keywords=KEYWORDS) -> str:
    began = time.process_time()
    with pytest.raises(ImageError) as caught:
        read_image(path, keywords)
    assert time.process_time() - began < 5.0
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(path.stem.lower()) or path.stem in str(caught.value)
    return str(caught.value)


def check_sidecar(picture) -> None:
    assert picture.exposure_s == 2.0
    assert picture.utc == "2030-01-01T00:00:01.000"
    assert MISSION.value(picture.header, "target") == "MOON"
    geometry = picture.header_geometry
    turn = Rotation.from_quat(SIDECAR["attitude"], scalar_first=True).as_matrix()
    np.testing.assert_allclose(geometry.camera_from_j2000, turn, atol=1e-12)
    np.testing.assert_array_equal(geometry.spacecraft_from_sun_km, SIDECAR["position_km"])
    np.testing.assert_array_equal(geometry.spacecraft_velocity_km_s, SIDECAR["velocity_km_s"])
    assert picture.header["camera.gain"] == 2


@pytest.fixture
def gray(tmp_path):
    """A gray PNG."""
    path = tmp_path / "a.png"
    Image.fromarray(PIXELS.astype(np.uint16)).save(path)
    return path


class TestDisplayPictures:
    @pytest.mark.parametrize("suffix", ["png", "tif"])
    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
    def test_gray(self, tmp_path, suffix, dtype):
        values = PIXELS.astype(dtype)
        values[3, 4] = np.iinfo(dtype).max
        path = tmp_path / f"a.{suffix}"
        Image.fromarray(values).save(path)
        picture = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(picture.image_dn, values)
        assert np.argwhere(picture.saturated).tolist() == [[3, 4]]

    def test_float_tiff(self, tmp_path):
        path = tmp_path / "a.tiff"
        Image.fromarray((PIXELS / 7.0).astype(np.float32)).save(path)
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, (PIXELS / 7.0).astype(np.float32))

    def test_jpeg(self, tmp_path):
        path = tmp_path / "a.jpg"
        Image.fromarray(np.full((32, 32), 90, np.uint8)).save(path)
        picture = read_image(path, KEYWORDS)
        assert abs(picture.image_dn - 90.0).max() <= 1.0
        assert any("JPEG keeps no faint detail" in message for message in picture.messages)

    @pytest.mark.parametrize(("channel", "row"), [("green", 1), ("3", 2), (1, 0)])
    def test_a_channel_of_colors(self, tmp_path, channel, row):
        path = tmp_path / "a.png"
        colors = RNG.integers(0, 255, (12, 20, 3)).astype(np.uint8)
        Image.fromarray(colors).save(path)
        picture = read_image(path, KeywordMap(channel=channel))
        np.testing.assert_array_equal(picture.image_dn, colors[..., row])
        assert "channel: 1, or green" in error_of(path)
        assert "red, green, blue" in error_of(path, KeywordMap(channel="violet"))

    def test_equal_channels_and_transparency(self, tmp_path):
        path = tmp_path / "a.png"
        colors = np.repeat(PIXELS.astype(np.uint8)[..., None], 4, axis=2)
        colors[..., 3] = 255
        colors[0, 0, 3] = 0
        Image.fromarray(colors, "RGBA").save(path)
        picture = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(picture.image_dn[1:], PIXELS[1:])
        assert np.argwhere(picture.bad).tolist() == [[0, 0]]

    @pytest.mark.parametrize("suffix", [".json", ".yaml", ".csv"])
    def test_sidecars(self, gray, suffix):
        beside = gray.with_suffix(suffix)
        if suffix == ".csv":
            words = {k: v for k, v in SIDECAR.items() if k != "camera"} | {"camera.gain": 2}
            cells = {k: " ".join(map(str, v)) if isinstance(v, list) else v for k, v in words.items()}
            beside.write_text("\n".join(f"{word},{cell}" for word, cell in cells.items()))
        else:
            beside.write_text(json.dumps(SIDECAR))  # which is YAML, too
        check_sidecar(read_image(gray, MISSION))

    def test_a_sidecar_tells_more_than_headers_of_the_mission(self, gray):
        gray.with_suffix(".json").write_text(json.dumps(SIDECAR))
        picture = read_image(gray, KeywordMap(exposure_s="EXPTIME"))
        assert (picture.exposure_s, picture.utc) == (2.0, SIDECAR["utc"])
        turn = Rotation.from_quat(SIDECAR["attitude"], scalar_first=True).as_matrix()
        np.testing.assert_allclose(picture.header_geometry.camera_from_j2000, turn, atol=1e-12)

    def test_without_a_sidecar_the_remedy_is_one(self, gray):
        assert 'put a sidecar a.json beside it, such as {"utc":' in error_of(gray, MISSION)

    def test_a_table_of_pictures(self, tmp_path):
        path = tmp_path / "b.png"
        Image.fromarray(PIXELS.astype(np.uint16)).save(path)
        path.with_suffix(".csv").write_text("file,utc,exposure_s\na.png,x,1\nb.png,2030-01-01T00:00:05,0.5\n")
        assert read_image(path, MISSION).exposure_s == 0.5

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            ({"exposure_s": -1}, "exposure_s: Input should be greater than 0"),
            ({"attitude": [1, 0]}, "attitude"),
            ({"utc": 5}, "utc: Input should be a valid string"),
            ([1], "words and their values"),
        ],
    )
    def test_wrong_sidecars(self, gray, words, said):
        gray.with_suffix(".json").write_text(json.dumps(words))
        assert said in error_of(gray)

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            ({"exposure_s": 1.0}, "a.json: no utc; state it there (or START)"),
            ({"utc": "2030-01-01T00:00:00"}, "a.json: no exposure_s; state it there (or EXP_MS)"),
            ({"utc": "2030-01-01T00:00:00", "exposure_s": float("nan")}, "no exposure_s"),
            ({"utc": "2999-01-01T00:00:00", "exposure_s": 1.0}, "no date of a picture from space"),
            ({"utc": "1907-01-01T00:00:00", "exposure_s": 1.0}, "no date of a picture from space"),
            (
                {"utc": "2030-02-30T00:00:00", "exposure_s": 1.0},
                "is no UTC (no such date, or not of the form 2015",
            ),
        ],
    )
    def test_what_a_mission_asks_for_is_said_in_the_words_of_a_sidecar(self, gray, words, said):
        gray.with_suffix(".json").write_text(json.dumps(words))
        assert said in error_of(gray, MISSION)

    @pytest.mark.parametrize("reference", ["start", "middle"])
    def test_a_sidecars_time_that_is_none_is_a_fault_of_the_sidecar(self, gray, reference):
        gray.with_suffix(".json").write_text('{"utc": "yesterday", "exposure_s": 1.0}')
        said = error_of(gray, replace(MISSION, time_reference=reference))
        assert "a.json: utc = 'yesterday' is no UTC" in said
        assert said.endswith("correct the sidecar.")

    def test_what_would_be_changed_or_is_damaged(self, gray):
        whole = bytearray(gray.read_bytes())
        gray.write_bytes(whole[: len(whole) - 60])
        assert "damaged PNG file" in error_of(gray)
        whole[24:26] = b"\x10\x02"
        gray.write_bytes(whole)
        assert "PNG" in error_of(gray)
        gray.with_suffix(".tif").write_bytes(b"II*\0" + bytes(40))
        assert "damaged TIFF file" in error_of(gray.with_suffix(".tif"))

    def test_a_library_tells_the_terminal_nothing_of_a_damaged_file(self, gray, caplog):
        path = gray.with_suffix(".tif")
        tifffile.imwrite(path, np.ones((6, 8)))
        damaged = bytearray(path.read_bytes())
        (folder,) = struct.unpack("<I", damaged[4:8])
        kind = (
            folder
            + 2
            + 2
            + 12 * [t for t, *_ in struct.iter_unpack("<HHII", damaged[folder + 2 : folder + 62])].index(256)
        )
        damaged[kind : kind + 10] = struct.pack("<HII", 5, 3, 1 << 30)  # its width: rationals beyond the end
        path.write_bytes(damaged)
        message = error_of(path)
        assert "TIFF" in message or "shape (0, 0)" in message  # newer tifffiles make an empty picture of it
        assert not caplog.records

    @pytest.mark.parametrize(
        ("dtype", "order", "sample_format"),
        [
            (np.uint32, "<", 1),
            (np.int8, "<", 2),
            (np.int32, ">", 2),
            (np.uint16, ">", 1),
            (np.float32, ">", 3),
        ],
    )
    def test_tiff_samples_keep_their_sign(self, tmp_path, dtype, order, sample_format):
        """Written by hand after the standard (TIFF 6.0), as instruments write them and no display does."""
        values = np.linspace(0.0, 1.0, 240).reshape(12, 20)
        low, high = (0, 1) if dtype == np.float32 else (np.iinfo(dtype).min, np.iinfo(dtype).max)
        values = (low + values * (float(high) - float(low))).astype(dtype)
        path = tmp_path / "a.tif"
        path.write_bytes(tiff(values, order, sample_format=sample_format))
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, values)

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_tiff_pixels_are_as_stored(self, tmp_path, orientation):
        path = tmp_path / "a.tif"
        path.write_bytes(tiff(PIXELS.astype(np.uint16), "<", orientation=orientation))
        picture = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(picture.image_dn, PIXELS)
        assert any("orientation tag" in message for message in picture.messages) == (orientation > 1)

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
    def test_tiff_whose_zero_is_white(self, tmp_path, dtype):
        path = tmp_path / "a.tif"
        path.write_bytes(tiff(PIXELS.astype(dtype), "<", photometric=0))
        expected = np.iinfo(dtype).max - PIXELS.astype(dtype)
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, expected)

    def test_bigtiff(self, tmp_path):
        values = (PIXELS * 100).astype(np.uint16)
        path = tmp_path / "a.tif"
        path.write_bytes(bigtiff(values))
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, values)

    @pytest.mark.parametrize(
        ("dtype", "options"),
        [
            ("f8", {}), ("f2", {}), (">f8", {"byteorder": ">"}), ("u2", {"bigtiff": True, "byteorder": ">"}),
            ("u2", {"bigtiff": True, "tile": (16, 16)}), ("f8", {"compression": "zlib"}),
            ("i2", {"byteorder": ">", "tile": (16, 32)}), ("f8", {"photometric": "miniswhite"}),
        ],
    )  # fmt: skip
    def test_tiff_of_another_program(self, tmp_path, dtype, options):
        """Files by tifffile, which scikit-image and MATLAB's users write: reals of 64 bits, tiles, the high byte first."""
        path = tmp_path / "a.tif"
        tifffile.imwrite(path, PIXELS.astype(dtype), **options)
        negative = "photometric" in options
        expected = PIXELS.astype(dtype).max() - PIXELS if negative else PIXELS
        picture = read_image(path, KEYWORDS)
        np.testing.assert_allclose(picture.image_dn, expected.astype(dtype), rtol=1e-12)
        assert any("white" in message for message in picture.messages) == negative

    def test_the_first_of_several_reals(self, tmp_path):
        tifffile.imwrite(
            tmp_path / "a.tif", np.stack([PIXELS, PIXELS + 1.0]).astype("f8"), photometric="minisblack"
        )
        picture = read_image(tmp_path / "a.tif", KEYWORDS)
        np.testing.assert_array_equal(picture.image_dn, PIXELS)
        assert "the first of 2 pictures in the file" in picture.messages

    def test_tiff_that_is_not_read(self, tmp_path):
        path = tmp_path / "a.tif"
        path.write_bytes(tiff(PIXELS.astype(np.complex64), "<", sample_format=6))
        assert "save it with 16-bit integers or 32-bit reals, or as FITS" in error_of(path)


def tiff(values, order, photometric=1, orientation=1, sample_format=1) -> bytes:
    """One strip after an 8-byte head, its tags behind it."""
    data = values.astype(values.dtype.newbyteorder(order)).tobytes()
    lines, samples = values.shape
    short = {
        256: samples,
        257: lines,
        258: 8 * values.itemsize,
        259: 1,
        262: photometric,
        274: orientation,
        277: 1,
    }
    short |= {278: lines, 339: sample_format}
    tags = {tag: (3, struct.pack(order + "HH", value, 0)) for tag, value in short.items()}
    tags |= {tag: (4, struct.pack(order + "I", value)) for tag, value in ((273, 8), (279, len(data)))}
    entries = b"".join(
        struct.pack(order + "HHI", tag, tags[tag][0], 1) + tags[tag][1] for tag in sorted(tags)
    )
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8 + len(data))
    return head + data + struct.pack(order + "H", len(tags)) + entries + bytes(4)


def bigtiff(values) -> bytes:
    """As `tiff`, the low byte first, with places of 8 bytes: a head of 16, entries of 20."""
    data = values.astype(values.dtype.newbyteorder("<")).tobytes()
    lines, samples = values.shape
    tags = {256: samples, 257: lines, 258: 8 * values.itemsize, 259: 1, 262: 1, 277: 1, 278: lines}
    entries = {tag: (3, struct.pack("<H6x", value)) for tag, value in tags.items()}
    entries |= {tag: (16, struct.pack("<Q", value)) for tag, value in ((273, 16), (279, len(data)))}
    body = b"".join(struct.pack("<HHQ", tag, entries[tag][0], 1) + entries[tag][1] for tag in sorted(entries))
    head = b"II" + struct.pack("<HHHQ", 43, 8, 0, 16 + len(data))
    return head + data + struct.pack("<Q", len(entries)) + body + bytes(8)


class TestRaw:
    @pytest.mark.parametrize(("kind", "dtype"), [("uint16", "<u2"), ("float32", ">f4"), ("uint8", "u1")])
    def test_picture(self, tmp_path, kind, dtype):
        path = tmp_path / "a.raw"
        path.write_bytes(b"\1" * 6 + PIXELS.astype(dtype).tobytes())
        order = "big" if dtype.startswith(">") else "little"
        layout = {"lines": 12, "samples": 20, "sample_type": kind, "byte_order": order, "offset_bytes": 6}
        path.with_suffix(".json").write_text(json.dumps(SIDECAR | layout))
        picture = read_image(path, MISSION)
        np.testing.assert_array_equal(picture.image_dn, PIXELS)
        check_sidecar(picture)

    @pytest.mark.parametrize(("bits", "order"), [(10, "little"), (12, "little"), (12, "big"), (14, "big")])
    def test_packed_samples(self, tmp_path, bits, order):
        """Bit after bit, as NumPy packs them; a line of 19 samples ends within a byte."""
        path, pixels = tmp_path / "a.raw", RNG.integers(0, 1 << bits, (12, 19))
        pixels[3, 4] = (1 << bits) - 1
        places = np.arange(bits) if order == "little" else np.arange(bits)[::-1]
        each = (pixels[..., None] >> places & 1).astype(np.uint8).reshape(12, -1)
        path.write_bytes(b"\7" * 6 + np.packbits(each, axis=1, bitorder=order).tobytes())
        layout = {
            "lines": 12,
            "samples": 19,
            "sample_type": f"uint{bits}",
            "byte_order": order,
            "header_bytes": 6,
        }
        path.with_suffix(".json").write_text(json.dumps(SIDECAR | layout))
        picture = read_image(path, MISSION)
        np.testing.assert_array_equal(picture.image_dn, pixels)
        assert picture.saturated[3, 4]
        path.write_bytes(b"\7" * 6 + pixels.astype("<u2").tobytes())
        assert "two bytes a sample; write sample_type: uint16" in error_of(path)

    def test_named_by_its_sidecar(self, tmp_path):
        (tmp_path / "pixels.dat").write_bytes(
            np.moveaxis([PIXELS, PIXELS + 1, PIXELS + 2], 0, 2).astype("<u2").tobytes()
        )
        path = tmp_path / "a.yaml"
        path.write_text(
            "file: PIXELS.DAT\nlines: 12\nsamples: 20\nchannels: 3\nexposure_s: 1\nutc: 2030-01-01T00:00:00\n"
        )
        picture = read_image(path, KeywordMap(channel="blue"))
        np.testing.assert_array_equal(picture.image_dn, PIXELS + 2)
        assert picture.path.name == "pixels.dat"

    def test_without_or_with_a_wrong_layout(self, tmp_path):
        path = tmp_path / "a.raw"
        path.write_bytes(bytes(100))
        assert "put a sidecar a.json beside it" in error_of(path)
        path.with_suffix(".json").write_text('{"utc": "2030-01-01T00:00:00"}')
        assert "a.json does not say its lines and samples" in error_of(path)
        path.with_suffix(".json").write_text('{"lines": 100, "samples": 100}')
        assert "100 of 20000 bytes" in error_of(path)
        path.with_suffix(".json").write_text('{"lines": 1000000, "samples": 1000000}')
        assert "more than" in error_of(path)


class TestIsisCubes:
    KEYWORDS = KeywordMap(
        exposure_s="ExposureDuration", exposure_scale=1e-3, utc="StartTime", time_reference="start"
    )

    @pytest.mark.parametrize("tile", [None, (5, 8), (12, 20)])
    @pytest.mark.parametrize(
        ("kind", "dtype"),
        [("UnsignedByte", "u1"), ("SignedWord", "<i2"), ("UnsignedWord", ">u2"), ("Real", "<f4")],
    )
    def test_picture(self, tmp_path, kind, dtype, tile):
        path = tmp_path / "a.cub"
        path.write_bytes(isis_bytes(PIXELS.astype(dtype)[None], kind, tile))
        picture = read_image(path, self.KEYWORDS)
        np.testing.assert_array_equal(picture.image_dn, 0.5 * PIXELS + 10.0)
        assert (picture.exposure_s, picture.utc) == (pytest.approx(0.09), "2000-02-25T05:16:12.701")
        assert not picture.bad.any()

    @pytest.mark.parametrize(
        ("kind", "dtype", "missing", "saturated"),
        [
            ("UnsignedByte", "u1", [0], [255]),
            ("SignedWord", "<i2", [-32768, -32767, -32766], [-32765, -32764]),
            ("UnsignedWord", "<u2", [0, 1, 2], [65534, 65535]),
        ],
    )
    def test_special_pixels(self, tmp_path, kind, dtype, missing, saturated):
        stored = PIXELS.astype(dtype)
        stored[0, : len(missing)] = missing
        stored[1, : len(saturated)] = saturated
        path = tmp_path / "a.cub"
        path.write_bytes(isis_bytes(stored[None], kind))
        picture = read_image(path, KEYWORDS)
        assert np.argwhere(picture.bad).tolist() == [[0, i] for i in range(len(missing))]
        assert np.argwhere(picture.saturated).tolist() == [[1, i] for i in range(len(saturated))]

    def test_special_floats(self, tmp_path):
        stored = PIXELS.astype("<f4")
        stored.view("<u4")[0, :5] = np.arange(0xFF7FFFFB, 0xFF800000, dtype=np.uint32)
        path = tmp_path / "a.cub"
        path.write_bytes(isis_bytes(stored[None], "Real"))
        picture = read_image(path, KEYWORDS)
        assert picture.bad[0, :5].tolist() == [True, True, True, False, False]
        assert picture.saturated[0, :5].tolist() == [False, False, False, True, True]

    def test_bands_maps_and_labels_alone(self, tmp_path):
        path = tmp_path / "a.cub"
        two = np.stack([PIXELS, PIXELS + 1]).astype("<u2")
        names = "  Group = BandBin\n    FilterName = (RED, GREEN)\n  End_Group\n"
        path.write_bytes(isis_bytes(two, "UnsignedWord", (12, 20), names))
        np.testing.assert_array_equal(
            read_image(path, KeywordMap(channel="green")).image_dn, 0.5 * PIXELS + 10.5
        )
        assert "cube of 2 x 12 x 20" in error_of(path)
        path.write_bytes(
            isis_bytes(two[:1], "UnsignedWord", None, "  Group = Mapping\n    A = 1\n  End_Group\n")
        )
        assert "map projection" in error_of(path)
        path.write_bytes(isis_bytes(two[:1], "UnsignedWord")[:2048])
        assert "without its samples" in error_of(path)
        path.write_bytes(isis_bytes(two[:1], "SignedInteger"))
        assert "'SignedInteger'" in error_of(path)


class TestPds4:
    KEYWORDS = KeywordMap(
        exposure_s="exposure_duration",
        exposure_scale=1e-3,
        utc="start_date_time",
        time_reference="start",
        target="Target_Identification.name",
    )

    @pytest.mark.parametrize(
        ("kind", "dtype"), [("UnsignedByte", "u1"), ("SignedMSB2", ">i2"), ("IEEE754LSBSingle", "<f4")]
    )
    def test_picture(self, tmp_path, kind, dtype):
        (tmp_path / "a.dat").write_bytes(bytes(7) + PIXELS.astype(dtype).tobytes())
        path = tmp_path / "a.xml"
        special = "<Special_Constants><missing_constant>5</missing_constant></Special_Constants>"
        path.write_bytes(pds4_label("A.DAT", (12, 20), kind, offset=7, more=special))
        picture = read_image(path, self.KEYWORDS)
        good = PIXELS != 5
        np.testing.assert_array_equal(picture.image_dn[good], 0.5 * PIXELS[good] + 10.0)
        np.testing.assert_array_equal(picture.bad, ~good)
        assert (picture.exposure_s, picture.utc) == (pytest.approx(0.09), "2000-02-25T05:16:12.701")
        assert self.KEYWORDS.value(picture.header, "target") == "Eros"

    @pytest.mark.parametrize(
        ("kind", "dtype", "bits"),
        [
            ("IEEE754MSBSingle", ">f4", 0xC2F60000),
            ("IEEE754LSBSingle", "<f4", 0xC2F60000),
            ("SignedMSB2", ">i2", 0x8001),
        ],
    )
    def test_constants_given_as_bits(self, tmp_path, kind, dtype, bits):
        values = PIXELS.astype(dtype)
        values[3, 4] = np.array(bits, f"u{values.dtype.itemsize}").view(f"{values.dtype.str[1:]}")
        (tmp_path / "a.dat").write_bytes(values.tobytes())
        path = tmp_path / "a.xml"
        special = f"<Special_Constants><missing_constant>0x{bits:X}</missing_constant></Special_Constants>"
        path.write_bytes(pds4_label("a.dat", (12, 20), kind, more=special))
        assert np.argwhere(read_image(path, self.KEYWORDS).bad).tolist() == [[3, 4]]

    @pytest.mark.parametrize("label_name", ["ce5_0001.2CL", "ce5_0001.lblx", "ce5_0001.XML"])
    def test_labels_of_other_agencies(self, tmp_path, label_name):
        """China's are named like their data with an L, ESA's name the PDS's space and may be in UTF-16."""
        data = tmp_path / "ce5_0001.2C"
        data.write_bytes(PIXELS.astype(">i2").tobytes())
        label, path = pds4_label("ce5_0001.2C", (12, 20), "SignedMSB2").decode(), tmp_path / label_name
        label = label.replace("<Product_Obs", "<p:Product_Obs").replace("</Product_Obs", "</p:Product_Obs")
        label = label.replace("xmlns=", "xmlns:p=").replace('unit="ms">90.0', 'unit="ns">9e7')
        path.write_bytes(label.encode("utf-16" if label_name.endswith("XML") else "utf-8"))
        picture = read_image(path, self.KEYWORDS)
        np.testing.assert_array_equal(picture.image_dn, 0.5 * PIXELS + 10.0)
        assert picture.exposure_s == pytest.approx(0.09)
        assert error_of(data).endswith(f"give its label {label_name}.")

    def test_a_fits_file_that_a_label_describes(self, tmp_path):
        fits.PrimaryHDU(PIXELS.astype(">i2")).writeto(tmp_path / "a.fits")
        path = tmp_path / "a.xml"
        path.write_bytes(pds4_label("a.fits", (12, 20), "SignedMSB2", offset=2880))
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, 0.5 * PIXELS + 10.0)

    def test_hostile_and_wrong_labels(self, tmp_path):
        path = tmp_path / "a.xml"
        good = pds4_label("a.dat", (12, 20), "SignedMSB2")
        path.write_bytes(good)
        assert "a.dat, which is not beside it" in error_of(path)
        (tmp_path / "a.dat").write_bytes(bytes(100))
        assert "100 of 480 bytes" in error_of(path)
        path.write_bytes(good.replace(b"SignedMSB2", b"ComplexMSB8"))
        assert "'ComplexMSB8' is not read" in error_of(path)
        bomb = b'<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
        path.write_bytes(good.replace(b"<Product", bomb + b"<Product", 1))
        assert "document type or entities" in error_of(path)
        path.write_bytes(good[:-40])
        assert "damaged PDS4 label" in error_of(path)
        path.write_bytes(good.replace(b"<Observation_Area>", b"<Observation_Area>" + b"<a>" * 5000))
        assert "more elements" in error_of(path)


class TestVicar:
    @pytest.mark.parametrize("dtype", ["u1", "<i2", ">i4", "<f4", ">f8"])
    def test_labels_at_both_ends(self, tmp_path, dtype):
        path = tmp_path / "a.img"
        path.write_bytes(vicar_bytes(PIXELS.astype(dtype), later={"NOTE": "Saturn's moon", "PAIR": [1, 2.5]}))
        picture = read_image(path, KEYWORDS)
        np.testing.assert_array_equal(picture.image_dn, PIXELS)
        assert (picture.header["NOTE"], picture.header["PAIR"]) == ("Saturn's moon", "1, 2.5")

    def test_vax_reals(self, tmp_path):
        """1.0, -2.5 and 0 as VAX F_floating: 4080 hex, c120 hex (VAX-11 Architecture Reference Manual)."""
        path = tmp_path / "a.img"
        words = np.array([[0x4080, 0, 0xC120, 0, 0, 0]], "<u2").view("<f4")
        path.write_bytes(vicar_bytes(words).replace(b"'RIEEE'", b"'VAX'  "))
        np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, [[1.0, -2.5, 0.0]])


class TestVoyager:
    def test_compressed_picture(self, tmp_path):
        image = np.clip(RNG.normal(40.0, 25.0, (9, 30)), 0, 255).astype(np.uint8)
        path = tmp_path / "c.imq"
        path.write_bytes(voyager_bytes(image))
        picture = read_image(path, KeywordMap(exposure_s="EXPOSURE_DURATION", utc="IMAGE_TIME"))
        np.testing.assert_array_equal(picture.image_dn, image)
        assert (picture.exposure_s, picture.utc[:19]) == (0.12, "1981-08-26T02:35:11")
        assert picture.header["IMAGE_ID"] == "1739S2-001"
        whole = path.read_bytes()
        path.write_bytes(whole[:-40])
        assert "truncated" in error_of(path)
        path.write_bytes(whole.replace(b"LINE_SAMPLES = 30", b"LINE_SAMPLES = 90"))
        assert "of 93 samples" in error_of(path)


def test_single_quotes_and_wrappers(tmp_path):
    """A label in an SFDU wrapper, with no version of its own, whose texts and pointer have single quotes."""
    (tmp_path / "a.dat").write_bytes(PIXELS.astype(">u2").tobytes())
    path = tmp_path / "a.lbl"
    path.write_text(
        "CCSD3ZF0000100000001NJPL3IF0PDS200000001 = SFDU_LABEL\r\nRECORD_TYPE = STREAM\r\n^IMAGE = 'A.DAT'\r\n"
        "NOTE = 'isn\"t it'\r\nNAMES = ('CL1','CL2')\r\nSTART_TIME = 2000-02-25T05:16:12\r\nOBJECT = IMAGE\r\n"
        " LINES = 12\r\n LINE_SAMPLES = 20\r\n SAMPLE_TYPE = 'MSB_UNSIGNED_INTEGER'\r\n SAMPLE_BITS = 16\r\n"
        "END_OBJECT\r\nEND\r\n"
    )
    picture = read_image(path, KEYWORDS)
    np.testing.assert_array_equal(picture.image_dn, PIXELS)
    assert (picture.header["NOTE"], picture.header["NAMES"]) == ('isn"t it', "CL1, CL2")


@pytest.mark.parametrize("detached", [False, True])
def test_gzipped_pds3(tmp_path, detached):
    """As archives send them: the file itself, or what its label names."""
    pixels = PIXELS.astype(">u2").tobytes()
    label = (
        f"PDS_VERSION_ID = PDS3\r\nRECORD_BYTES = 1024\r\n^IMAGE = {'A.DAT' if detached else 2}\r\nOBJECT = IMAGE\r\n"
        " LINES = 12\r\n LINE_SAMPLES = 20\r\n SAMPLE_TYPE = MSB_UNSIGNED_INTEGER\r\n SAMPLE_BITS = 16\r\n"
        "END_OBJECT\r\nEND\r\n"
    ).encode()
    path = tmp_path / ("a.lbl" if detached else "a.img.gz")
    path.write_bytes(label if detached else gzip.compress(label.ljust(1024) + pixels))
    if detached:
        (tmp_path / "a.dat.gz").write_bytes(gzip.compress(pixels))
    np.testing.assert_array_equal(read_image(path, KEYWORDS).image_dn, PIXELS)


@pytest.mark.parametrize("constant", ["-1.0E32", "16#F49DC5AE#"])
def test_missing_samples_of_a_pds3_picture(tmp_path, constant):
    """A special constant as a number, and as the bits of one (PDS Standards Reference 3.8, 12.3)."""
    values = PIXELS.astype(">f4")
    values[2, 3] = -1e32
    label = (
        "PDS_VERSION_ID = PDS3\r\nRECORD_BYTES = 1024 <BYTES>\r\n^IMAGE = 2\r\nOBJECT = IMAGE\r\n LINES = 12 <PIXEL>\r\n"
        " LINE_SAMPLES = 20\r\n SAMPLE_TYPE = IEEE_REAL\r\n SAMPLE_BITS = 32\r\n"
        f" MISSING_CONSTANT = {constant}\r\nEND_OBJECT\r\nEND\r\n"
    )
    path = tmp_path / "a.img"
    path.write_bytes(label.encode().ljust(1024) + values.tobytes())
    picture = read_image(path, KEYWORDS)
    assert np.argwhere(picture.bad).tolist() == [[2, 3]]
    np.testing.assert_array_equal(picture.image_dn[3:], PIXELS[3:])


def test_bands_of_a_pds3_picture(tmp_path):
    bands = np.stack([PIXELS, PIXELS + 1, PIXELS + 2])
    for order, stored in {
        "BAND_SEQUENTIAL": bands,
        "LINE_INTERLEAVED": bands.swapaxes(0, 1),
        "SAMPLE_INTERLEAVED": np.moveaxis(bands, 0, 2),
    }.items():
        label = (
            "PDS_VERSION_ID = PDS3\r\nRECORD_BYTES = 1024\r\n^IMAGE = 2\r\nOBJECT = IMAGE\r\n LINES = 12\r\n"
            f" LINE_SAMPLES = 20\r\n BANDS = 3\r\n BAND_STORAGE_TYPE = {order}\r\n"
            " SAMPLE_TYPE = LSB_INTEGER\r\n SAMPLE_BITS = 16\r\nEND_OBJECT\r\nEND\r\n"
        )
        path = tmp_path / "a.img"
        path.write_bytes(label.encode().ljust(1024) + stored.astype("<i2").tobytes())
        np.testing.assert_array_equal(read_image(path, KeywordMap(channel=2)).image_dn, PIXELS + 1)


def test_folders_take_pictures_of_displays_only_with_a_sidecar(tmp_path):
    for name in ("a.png", "b.png", "c.cub", "b.json"):
        (tmp_path / name).write_bytes(b"x")
    assert [path.name for path in picture_files([tmp_path])] == ["b.png", "c.cub"]


@pytest.mark.realdata
class TestArchives:
    """Files of the Planetary Data System (see the data folder): what one reader makes of them, others confirm."""

    @pytest.fixture
    def formats(self, data_dir):
        return data_dir / "images" / "formats"

    def test_a_compressed_voyager_picture_is_that_of_its_cube(self, formats):
        """The cube was made by ISIS (voy2isis), which has its own decompression; 0 is no value there."""
        packed = read_image(formats / "c4400436.imq", KEYWORDS)
        cube = read_image(formats / "c4400436.cub", KEYWORDS)
        valid = ~(cube.bad | cube.saturated)
        np.testing.assert_array_equal(packed.image_dn[valid], cube.image_dn[valid])
        np.testing.assert_array_equal(packed.saturated, cube.saturated)
        assert (packed.image_dn[cube.bad] == 0.0).all()
        assert cube.bad.sum() == 532

    def test_galileo_by_its_label_and_alone(self, formats):
        keywords = KeywordMap(exposure_s="EXPOSURE_DURATION", exposure_scale=1e-3, utc="IMAGE_TIME")
        labelled = read_image(formats / "6300r.lbl", keywords)
        np.testing.assert_array_equal(labelled.image_dn, read_image(formats / "6300r.img", KEYWORDS).image_dn)
        assert labelled.utc == "1999-11-26T04:53:00.173"
        assert labelled.exposure_s == pytest.approx(0.04583)
        assert labelled.image_dn.shape == (800, 800)

    def test_vicar_labels(self, formats):
        galileo = read_image(formats / "C0532836239R.IMG", KeywordMap(exposure_s="EXP", exposure_scale=1e-3))
        assert (galileo.header["MISSION"], galileo.header["TARGET"]) == ("GALILEO", "EUROPA")
        assert galileo.exposure_s == pytest.approx(0.0125003)
        voyager = read_image(formats / "C2069302_RAW.IMG", KEYWORDS)
        assert voyager.header["LAB02"].startswith("VGR-2   FDS 20693.02")
        assert voyager.image_dn.shape == (800, 800)
