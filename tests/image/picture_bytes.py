"""Picture files in bytes, written by the documents that describe their formats: what the readers' tests are given."""

import heapq

import numpy as np

VICAR_FORMATS = {"u1": "BYTE", "i2": "HALF", "i4": "FULL", "f4": "REAL", "f8": "DOUB"}


def vicar_text(value: object) -> str:
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, list):
        return f"({','.join(vicar_text(part) for part in value)})"
    return str(value)


def vicar_bytes(array: np.ndarray, *, later: dict[str, object] | None = None, **items: object) -> bytes:
    """VICAR, D-4186: system items, items of properties, the samples; with `later` items in a label at the end."""
    bands, lines, samples = array.shape if array.ndim == 3 else (1, *array.shape)
    size = array.dtype.itemsize
    system = {
        "FORMAT": VICAR_FORMATS[f"{array.dtype.kind}{size}"], "TYPE": "IMAGE", "BUFSIZ": 20480, "DIM": 3,
        "EOL": int(later is not None), "RECSIZE": samples * size, "ORG": "BSQ", "NL": lines, "NS": samples, "NB": bands,
        "N1": samples, "N2": lines, "N3": bands, "N4": 0, "NBB": 0, "NLB": 0, "HOST": "TEST",
        "INTFMT": "LOW" if array.dtype.byteorder in "<=" else "HIGH",
        "REALFMT": "RIEEE" if array.dtype.byteorder in "<=" else "IEEE",
    }  # fmt: skip

    def label(values: dict[str, object], room: int) -> bytes:
        text = "  ".join(f"{name}={vicar_text(value)}" for name, value in values.items())
        return f"LBLSIZE={room:<16}{text}".encode().ljust(room, b"\0")

    end = b"" if later is None else label(later, 256)
    return label(system | items, 1024) + array.tobytes() + end


def isis_bytes(stored: np.ndarray, kind: str, tile: tuple[int, int] | None = None, groups: str = "") -> bytes:
    """An ISIS cube of samples (band, line, sample): in tiles (lines, samples) that are whole at every end, or in bands."""
    bands, lines, samples = stored.shape
    order = "Msb" if stored.dtype.byteorder == ">" else "Lsb"
    layout = f"    TileSamples = {tile[1]}\n    TileLines   = {tile[0]}\n" if tile else ""
    label = f"""Object = IsisCube
  Object = Core
    StartByte   = 2049
    Format      = {"Tile" if tile else "BandSequential"}
{layout}
    Group = Dimensions
      Samples = {samples}
      Lines   = {lines}
      Bands   = {bands}
    End_Group

    Group = Pixels
      Type       = {kind}
      ByteOrder  = {order}
      Base       = 10.0
      Multiplier = 0.5
    End_Group
  End_Object

  Group = Instrument
    StartTime        = 2000-02-25T05:16:12.656
    ExposureDuration = 90.0 <ms>
  End_Group
{groups}End_Object

Object = Label
  Bytes = 2048
End_Object
End
"""
    data = b"".join(_tile_bytes(stored, tile)) if tile else stored.tobytes()
    return label.encode().ljust(2048, b"\0") + data


def _tile_bytes(stored: np.ndarray, tile: tuple[int, int]) -> list[bytes]:
    tiles = []
    for band in stored:
        for line in range(0, band.shape[0], tile[0]):
            for sample in range(0, band.shape[1], tile[1]):
                part = band[line : line + tile[0], sample : sample + tile[1]]
                whole = np.zeros(tile, stored.dtype)
                whole[: part.shape[0], : part.shape[1]] = part
                tiles.append(whole.tobytes())
    return tiles


def pds4_label(name: str, shape: tuple[int, ...], kind: str, *, offset: int = 0, more: str = "") -> bytes:
    axes = "".join(
        f"<Axis_Array><axis_name>A{n}</axis_name><elements>{size}</elements><sequence_number>{n}</sequence_number></Axis_Array>"
        for n, size in enumerate(shape, start=1)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:img="http://pds.nasa.gov/pds4/img/v1">
 <Observation_Area><Time_Coordinates><start_date_time>2000-02-25T05:16:12.656Z</start_date_time></Time_Coordinates>
  <Target_Identification><name>Eros</name></Target_Identification>
  <img:Exposure><img:exposure_duration unit="ms">90.0</img:exposure_duration></img:Exposure></Observation_Area>
 <File_Area_Observational><File><file_name>{name}</file_name></File>
  <Array_{len(shape)}D_Image><offset unit="byte">{offset}</offset><axes>{len(shape)}</axes>
   <axis_index_order>Last Index Fastest</axis_index_order>
   <Element_Array><data_type>{kind}</data_type><scaling_factor>0.5</scaling_factor><value_offset>10</value_offset>
   </Element_Array>{axes}{more}</Array_{len(shape)}D_Image></File_Area_Observational>
</Product_Observational>
""".encode()


def voyager_bytes(image: np.ndarray, suffix: int = 3) -> bytes:
    """A compressed picture in records led by their length, as on the volumes of Voyager.

    The code is made with a heap, the reader's with a sorted list: of weights as large, the pair joined last goes first.
    """
    lines, samples = image.shape
    whole = np.pad(image, ((0, 0), (0, suffix))).astype(np.int64)
    steps = (whole[:, :-1] - whole[:, 1:]) % 256  # the next is the one before minus the step
    names = np.where(steps == 0, 256, steps)  # 1 to 256
    counts = np.bincount(names.ravel(), minlength=512)[1:512]
    codes = _codes(counts)
    records = []
    for row in range(lines):
        bits = [bit for name in names[row] for bit in codes[int(name) - 1]]
        records.append(bytes([int(whole[row, 0])]) + np.packbits(np.array(bits, np.uint8)).tobytes())
    histogram = counts.astype("<u4").tobytes()
    label = f"""CCSD3ZF0000100000001NJPL3IF0PDS200000001 = SFDU_LABEL
RECORD_TYPE = VARIABLE_LENGTH
^ENCODING_HISTOGRAM = 16
^IMAGE = 19
/* made for a test */
IMAGE_ID = '1739S2-001'
IMAGE_TIME = 1981-08-26T02:35:11Z
EXPOSURE_DURATION = 0.1200 <SECONDS>
OBJECT = IMAGE
 ENCODING_TYPE = HUFFMAN_FIRST_DIFFERENCE
 LINES = {lines}
 LINE_SAMPLES = {samples}
 LINE_SUFFIX_BYTES = {suffix}
END_OBJECT
END""".encode().split(b"\n")
    assert len(label) == 15
    parts = [*label, histogram[:836], histogram[836:1672], histogram[1672:], *records]
    return b"".join(len(p).to_bytes(2, "little") + p + b"\0" * (len(p) % 2) for p in parts)


def _codes(counts: np.ndarray) -> dict[int, list[int]]:
    heap: list[tuple[int, int, list[int]]] = [(int(c), n, [n]) for n, c in enumerate(counts) if c]
    heapq.heapify(heap)
    codes: dict[int, list[int]] = {n: [] for _, n, _ in heap}
    joined = 0
    while len(heap) > 1:
        rarer, other = heapq.heappop(heap), heapq.heappop(heap)
        for n in rarer[2]:
            codes[n].insert(0, 0)
        for n in other[2]:
            codes[n].insert(0, 1)
        joined -= 1
        heapq.heappush(heap, (rarer[0] + other[0], joined, rarer[2] + other[2]))
    return codes
