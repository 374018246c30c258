"""`dipole texture`: maps images of colours to images of media."""

import struct
import zlib

import numpy as np
import pytest
from command_line import BAD_ROWS, FAILED, dipole


def write_png(path, values: np.ndarray, *more: tuple[bytes, bytes]) -> None:
    """Writes integers [height, width, channels] of 8 or 16 bits. more: names and bodies of chunks."""
    height, width, channels = values.shape
    bits = 8 * values.dtype.itemsize
    rows = values.astype(values.dtype.newbyteorder(">"))
    data = b"".join(b"\0" + row.tobytes() for row in rows)

    def chunk(name: bytes, body: bytes) -> bytes:
        checksum = zlib.crc32(name + body)
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", checksum)

    kind = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    header = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + b"".join(chunk(*one) for one in more)
        + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")
    )


def write_pfm(path, values: np.ndarray) -> None:
    height, width, channels = values.shape
    kind = "PF" if channels == 3 else "Pf"
    body = values[::-1].astype("<f4").tobytes()
    path.write_bytes(f"{kind}\n{width} {height}\n-1.0\n".encode() + body)


def read_pfm(path) -> np.ndarray:
    kind, size, scale, body = path.read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    assert float(scale) == -1
    channels = {b"PF": 3, b"Pf": 1}[kind]
    return np.frombuffer(body, "<f4").reshape(height, width, channels)[::-1]


def decoded(shares: np.ndarray) -> np.ndarray:
    """Linear light of sRGB: IEC 61966-2-1."""
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def texture(*arguments, **options):
    return dipole("texture", *map(str, arguments), usual=True, **options)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("type", [np.uint8, np.uint16])
def test_media_have_the_colours_of_a_png(tmp_path, client, channels, type):
    source = np.random.default_rng(channels)
    most = np.iinfo(type).max
    sides = (300, 300) if channels == 3 else (5, 7)  # of three channels in more than one request
    values = source.integers(most // 8, most, (*sides, channels), dtype=type)
    write_png(tmp_path / "in.png", values)
    path = "1" if channels < 3 else "1,.5,.3"
    run = texture(tmp_path / "in.png", tmp_path / "out.pfm", "--model", "better",
                  "--mean-free-path", path, "--g", ".2", "--eta", "1.4", quiet=False)
    told = "in.png: 35 of 35 pixels are not opaque; their opacity (alpha) is left out"
    assert (told in run.stderr) == (channels in (2, 4)) == (run.stderr != "")
    colours = decoded(values[..., : 1 if channels < 3 else 3] / most)  # without the opacity
    lengths = 1.0 if channels < 3 else [1.0, 0.5, 0.3]
    found = client.varying("better", colour=colours, length=lengths, g=0.2, eta=1.4)
    for name in ("sigma_a", "sigma_s"):
        written = read_pfm(tmp_path / f"out.{name}.pfm")
        np.testing.assert_allclose(written, found[name], rtol=1e-5, atol=1e-6)


# The primaries of sRGB and of Adobe RGB (1998), adapted to D50 (ICC.1, Annex E): columns are X, Y, Z.
SRGB = np.array([[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.7141]])
ADOBE = np.array([[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]])


def profile(columns: np.ndarray | None, curve: list[int]) -> bytes:
    """Returns an ICC profile of a display by its primaries and its curve: no number for linear light,
    an exponent times 256, or samples up to 65535. columns: None for a profile without either."""
    tags, body = {}, b""
    head = struct.pack(">I4s4s4s4s", 0, bytes(4), b"\2\x10\0\0", b"mntr", b"RGB ") + b"XYZ "
    head += bytes(12) + b"acsp" + bytes(28) + struct.pack(">III", 0xF6D6, 0x10000, 0xD32D) + bytes(48)
    if columns is not None:
        for name, column in zip("rgb", columns.T):
            tags[f"{name}XYZ"] = b"XYZ " + bytes(4) + np.round(column * 65536).astype(">i4").tobytes()
            tags[f"{name}TRC"] = b"curv" + struct.pack(f">II{len(curve)}H", 0, len(curve), *curve)
    tags["desc"] = b"desc" + bytes(8) + bytes(range(100))  # libpng passes over small profiles
    table = struct.pack(">I", len(tags))
    for name, one in tags.items():
        place = 128 + 4 + 12 * len(tags) + len(body)
        table += name.encode() + struct.pack(">II", place, len(one))
        body += one + bytes(-len(one) % 4)
    whole = head + table + body
    return b"p\0\0" + zlib.compress(struct.pack(">I", len(whole)) + whole[4:])


def of_adobe(shares: np.ndarray) -> np.ndarray:
    return shares ** (563 / 256) @ np.linalg.inv(SRGB).dot(ADOBE).T


CURVE = [int(round(65535 * value)) for value in decoded(np.linspace(0, 1, 1024))]
COLOURS = {  # what a file says, and what its values then are
    "nothing": (None, None, decoded),
    "linear gAMA": (b"gAMA", struct.pack(">I", 100000), lambda x: x),
    "gAMA of sRGB": (b"gAMA", struct.pack(">I", 45455), decoded),
    "gAMA 1 / 1.8": (b"gAMA", struct.pack(">I", 55556), lambda x: x**1.8),
    "cICP of sRGB": (b"cICP", bytes([1, 13, 0, 1]), decoded),
    "profile of sRGB": (b"iCCP", profile(SRGB, CURVE), decoded),
    "profile of linear light": (b"iCCP", profile(SRGB, []), lambda x: x),
    "profile of Adobe RGB": (b"iCCP", profile(ADOBE, [563]), of_adobe),
}  # fmt: skip


@pytest.mark.parametrize("type", [np.uint8, np.uint16])
@pytest.mark.parametrize("said", COLOURS)
def test_a_png_says_what_its_values_are(tmp_path, said, type):
    name, body, decode = COLOURS[said]
    most = np.iinfo(type).max
    values = np.random.default_rng(3).integers(most * 5 // 8, most * 7 // 8, (3, 4, 3), dtype=type)
    write_png(tmp_path / "in.png", values, *([(name, body)] if name else []))
    write_pfm(tmp_path / "in.pfm", decode(values / most))
    write_pfm(tmp_path / "linear.pfm", values / most)
    options = ["--mean-free-path", "1", "--model", "better", "--coefficients", "sigma_a"]
    for png, pfm, more in (("in.png", "in.pfm", []), ("in.png", "linear.pfm", ["--linear"])):
        for file in (png, pfm):
            texture(tmp_path / file, tmp_path / f"{file}.out.pfm", *options, *more)
        found, expected = (read_pfm(tmp_path / f"{file}.out.pfm") for file in (png, pfm))
        # The numbers of a profile are rounded to 1e-5, of which sigma_a makes much near albedo 1.
        np.testing.assert_allclose(found, expected, rtol=3e-2 if "profile" in said else 2e-4)


def test_float_images_and_random_walks(tmp_path, client):
    colours = np.random.default_rng(1).uniform(0.01, 0.9, (6, 4, 3))
    write_pfm(tmp_path / "in.pfm", colours)
    arguments = ["--diffuse-mean-free-path", "2", "--coefficients", "scattered", "--model", "better"]
    texture(tmp_path / "in.pfm", tmp_path / "out.pfm", *arguments)
    texture(tmp_path / "in.pfm", tmp_path / "out.png", *arguments)
    found = client.varying("better", colour=colours.astype("<f4"), length=2.0,
                           given="diffuse-mean-free-path", coefficients="scattered")
    np.testing.assert_array_equal(read_pfm(tmp_path / "out.pfm"), found["scattered"])
    for more in ["--linear"], []:  # the PNG says that it is linear
        texture(tmp_path / "out.png", tmp_path / f"again{len(more)}.pfm", *more, *arguments)
    assert (tmp_path / "again0.pfm").read_bytes() == (tmp_path / "again1.pfm").read_bytes()
    for name, length in ("mm", ["2"]), ("cm", ["0.2", "--unit", "cm"]):
        more = ["--mean-free-path", *length, "--coefficients", "sigma_a", "--model", "better"]
        texture(tmp_path / "in.pfm", tmp_path / f"{name}.pfm", *more)
    assert (tmp_path / "mm.pfm").read_bytes() == (tmp_path / "cm.pfm").read_bytes()
    whole = (tmp_path / "in.pfm").read_bytes()
    for end in b"\r\n", b"\r":  # other ends of lines, and the least byte that may be one
        body = b"\n\0\0\x3f" + whole.split(b"\n", 3)[3][4:]
        (tmp_path / "other.pfm").write_bytes(b"PF\n4 6\n-1.0".replace(b"\n", end) + end + body)
        (tmp_path / "usual.pfm").write_bytes(b"PF\n4 6\n-1.0\n" + body)
        for name in "other", "usual":
            texture(tmp_path / f"{name}.pfm", tmp_path / f"{name}.out.pfm", *arguments)
        found, expected = ((tmp_path / f"{name}.out.pfm").read_bytes() for name in ("other", "usual"))
        assert found == expected


def test_files_that_are_wrong(tmp_path):
    vast, pq, other, none = (tmp_path / f"{name}.png" for name in "vpon")
    grey = np.zeros((1, 1, 3), np.uint8)
    write_png(pq, grey, (b"cICP", bytes([9, 16, 0, 1])))
    write_png(other, grey, (b"iCCP", profile(None, [])))
    write_png(none, grey + 255, (b"iCCP", b"p\0\0" + zlib.compress(b"profile")))
    write_png(vast, grey)
    size = struct.pack(">4sIIBBBBB", b"IHDR", 65536, 65536, 8, 2, 0, 0, 0)
    head = size + struct.pack(">I", zlib.crc32(size))
    vast.write_bytes(vast.read_bytes()[:12] + head + vast.read_bytes()[12 + len(head) :])
    path, out = ["--mean-free-path", "1"], tmp_path / "out.pfm"
    for name, data, said in (
        ("vast.png", vast.read_bytes(), "ends too early"),
        ("pq.png", pq.read_bytes(), "its values are by a cICP chunk or a colour profile that is not known"),
        ("other.png", other.read_bytes(), "its values are by a cICP chunk or a colour profile that is not known"),
    ):
        (tmp_path / name).write_bytes(data)
        assert said in texture(tmp_path / name, out, *path, status=FAILED).stderr, name
    run = texture(none, out, *path, "--model", "better", quiet=False)
    assert "n.png: its colour profile is not used: iCCP" in run.stderr


def test_colours_without_a_medium(tmp_path):
    colours = np.full((420, 420, 3), 0.5)  # in three requests: none is missing of the first
    colours[250, 2, 1] = 1.25
    colours[419, 419, 2] = np.nan
    write_pfm(tmp_path / "in.pfm", colours)
    run = texture(tmp_path / "in.pfm", tmp_path / "out.pfm", "--model", "better",
                  "--mean-free-path", "1", status=BAD_ROWS)
    assert f"2 of 529200 values are NaN in what was written: no medium has their colour, which is from" in run.stderr
    assert "; the first is green of column 2, row 250: " in run.stderr
    sigma_a = read_pfm(tmp_path / "out.sigma_a.pfm")
    assert np.argwhere(np.isnan(sigma_a)).tolist() == [[250, 2, 1], [419, 419, 2]]
