# SPDX-License-Identifier: BSD-3-Clause
"""Depth images and their cameras, packed or not, to points in the camera's frame."""

from __future__ import annotations

import io
import posixpath
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.words import number_of
from ndtree.logs.folders.depth_image import Camera, png_pixels, points_of
from ndtree.logs.ros.messages.beams import COMPRESSED_IMAGE, SWAPPED, Beams, is_swapped, pitch_of

#: Images that hold depths: type of a pixel, and its values in a metre.
DEPTH_ENCODINGS = {
    **dict.fromkeys(("16UC1", "mono16", "Z16"), ("u2", 1000.0)),
    **{"16SC1": ("i2", 1000.0), "32FC1": ("f4", 1.0)},
}
_BY_LOWER_CASE = {name.lower(): name for name in DEPTH_ENCODINGS}
#: What stands before the picture in compressedDepth: a number, and two of its quantisation.
_CONFIG = struct.Struct("<iff")
_PNG = b"\x89PNG"
#: Where a PNG says how many bits a value has, and which colours: grey is 0.
_BITS, _GREY_OF_16_BITS = slice(24, 26), bytes([16, 0])


def depth_beams(message: Any, camera: Camera, pixel_stride: int) -> Beams:
    """Points of a depth image; pixels without depth are no beams."""
    image, swapped = _pixels(message)
    points = points_of(image, camera, pixel_stride=pixel_stride)
    return Beams(points, odd={SWAPPED: f"{len(points)} points"} if swapped else {})


def encoding_of(message: Any) -> str:
    """How the pixels of an Image or a CompressedImage are encoded, "" where it does not say.

    Of depths one of `DEPTH_ENCODINGS`, in whatever case it is written. A CompressedImage may say only that it
    is a PNG: one of 16 bits and one channel holds depths.
    """
    is_packed = message.__msgtype__ == COMPRESSED_IMAGE
    said = str(message.format).split(";")[0].strip() if is_packed else str(message.encoding).strip()
    known = _BY_LOWER_CASE.get(said.lower())
    if known is None and is_packed and _is_grey_of_16_bits(message.data):
        return "16UC1"
    return known or said


def _is_grey_of_16_bits(data: Any) -> bool:
    head = np.asarray(data[:64], dtype=np.uint8).tobytes()
    parts = [part for part in (head, head[_CONFIG.size :]) if part.startswith(_PNG)]
    return any(part[_BITS] == _GREY_OF_16_BITS for part in parts)


def scale_of(message: Any) -> float:
    """An image's values in a metre; ValueError if it holds no depths."""
    encoding = encoding_of(message)
    if encoding not in DEPTH_ENCODINGS:
        raise ValueError(f"the image has encoding {encoding!r}, expected {', '.join(DEPTH_ENCODINGS)}")
    return DEPTH_ENCODINGS[encoding][1]


def size_of(message: Any) -> tuple[int, int]:
    """Width and height [px]."""
    if message.__msgtype__ == COMPRESSED_IMAGE:
        height, width = depth_of(message).shape
        return width, height
    return int(message.width), int(message.height)


def depth_of(message: Any) -> NDArray[Any]:
    """The pixels of a depth image, (rows, columns), in its own unit."""
    return _pixels(message)[0]


def _pixels(message: Any) -> tuple[NDArray[Any], bool]:
    """The same, and whether the message's bytes are in the other order than it says."""
    scale_of(message)
    if message.__msgtype__ == COMPRESSED_IMAGE:
        return _unpacked(message), False
    kind = np.dtype((">" if message.is_bigendian else "<") + DEPTH_ENCODINGS[encoding_of(message)][0])
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.ascontiguousarray(message.data, dtype=np.uint8)
    if height and width:
        step = pitch_of(step, height, width * kind.itemsize, len(data))
    needed = (height - 1) * step + width * kind.itemsize if height and width else 0
    if step < width * kind.itemsize or len(data) < needed:
        rows = f"{number_of(height, 'row')} of {step} bytes and {width} pixels of {kind.itemsize}"
        raise ValueError(f"the image has {len(data)} bytes, expected {needed} for {rows}")
    image = np.ndarray((height, width), kind, data, strides=(step, kind.itemsize))
    swapped = is_swapped(image)
    if swapped:
        kind = kind.newbyteorder()
        image = image.view(kind)
    return image if kind.isnative else image.astype(kind.newbyteorder("=")), swapped


def _unpacked(message: Any) -> NDArray[Any]:
    """The pixels of a CompressedImage: a PNG of 16 bits, or compressedDepth with one in it, or with RVL.

    compressedDepth of an image in metres holds their inverse, quantised: depth is a / (value - b).
    """
    data = np.asarray(message.data, dtype=np.uint8).tobytes()
    is_metres = encoding_of(message) == "32FC1"
    a = b = 0.0
    is_rvl = "compresseddepth rvl" in " ".join(message.format.lower().split())
    if (is_rvl and len(data) >= _CONFIG.size) or data[_CONFIG.size :].startswith(_PNG):
        _, a, b = _CONFIG.unpack_from(data)
        data = data[_CONFIG.size :]
    elif not data.startswith(_PNG) or is_metres:
        expected = "a PNG of 16 bits, as compressedDepth or plain, or compressedDepth with RVL"
        raise ValueError(f"the image is packed as {message.format!r}, expected {expected}")
    values = rvl_image(data) if is_rvl else png_pixels(io.BytesIO(data), "the image")
    if not is_metres:
        return values
    depth = np.full(values.shape, np.nan, dtype=np.float32)
    known = values > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        depth[known] = a / (values[known].astype(np.float64) - b)
    return depth


def camera_of_info(message: Any, scale: float) -> Camera:
    """The camera of a CameraInfo of ROS 1 or 2, of the rectified image if it has one."""
    projection = np.asarray(message.p if hasattr(message, "p") else message.P, dtype=np.float64)
    matrix = np.asarray(message.k if hasattr(message, "k") else message.K, dtype=np.float64)
    if projection.shape == (12,) and projection[0] > 0:
        fx, cx, fy, cy = projection[[0, 2, 5, 6]]
    else:
        fx, cx, fy, cy = matrix[[0, 2, 4, 5]]
    return Camera(float(fx), float(fy), float(cx), float(cy), scale)


def is_beside(info_topic: str, image_topic: str) -> bool:
    """Whether a CameraInfo belongs to an image by its name; a packed image has a name one level deeper."""
    folder = posixpath.dirname(info_topic)
    own = posixpath.dirname(image_topic)
    return folder in (own, posixpath.dirname(own)) if folder else not own


#: Width and height, before what RVL packs.
_SIZE = struct.Struct("<ii")
#: No camera has more pixels: what says so is damaged.
MOST_PIXELS = 1 << 26
#: Groups of three bits that a number may have: those of a difference of 16 bits, of a run, have fewer.
_MOST_GROUPS = 10


def rvl_image(data: bytes) -> NDArray[np.uint16]:
    """An image (rows, columns) packed by RVL: its width and height, and words of eight numbers of 4 bits.

    A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017.

    Three bits of each are of a value, the lowest first, and the fourth says that more follow. The values are,
    over and over: how many pixels have no depth, how many then have one, and for each of these the difference
    to the one before, with its sign as the lowest bit.

    Raises ValueError if they are too few, or say something impossible.
    """
    if len(data) < _SIZE.size:
        raise ValueError(f"the image has {len(data)} bytes, expected its size and RVL")
    width, height = _SIZE.unpack_from(data)
    pixels = width * height
    if width < 0 or height < 0 or pixels > MOST_PIXELS:
        raise ValueError(f"the image has {width} x {height} pixels, expected at most {MOST_PIXELS}")
    values = _values(data[_SIZE.size :])
    places: list[NDArray[np.intp]] = []
    steps: list[NDArray[np.int64]] = []
    at = done = 0
    while done < pixels:
        if at + 1 >= len(values):
            raise ValueError(f"the image ends after {done} pixels, expected {width} x {height}")
        empty, full = int(values[at]), int(values[at + 1])
        at += 2
        if empty + full == 0 or done + empty + full > pixels or at + full > len(values):
            raise ValueError(
                f"the image has a run of {empty} and {full} pixels after {done}, expected {width} x {height}"
            )
        places.append(np.arange(done + empty, done + empty + full))
        steps.append(values[at : at + full])
        at += full
        done += empty + full
    image = np.zeros(pixels, dtype=np.uint16)
    if places:
        every = np.concatenate(steps)
        signed = (every >> 1) ^ -(every & 1)
        image[np.concatenate(places)] = np.cumsum(signed).astype(np.uint16)  # Overflows as 16 bits do.
    return image.reshape(height, width)


def _values(data: bytes) -> NDArray[np.int64]:
    """The numbers that are spread over groups of three bits."""
    words = np.frombuffer(data, dtype="<u4", count=len(data) // 4)
    shifts = np.arange(28, -1, -4, dtype=np.uint32)
    groups = ((words[:, None] >> shifts) & 15).ravel().astype(np.int64)
    ends = np.flatnonzero(groups < 8)
    if not len(ends):
        return np.zeros(0, dtype=np.int64)
    starts = np.concatenate([[0], ends[:-1] + 1])
    groups = groups[: ends[-1] + 1]
    lengths = ends - starts + 1
    if lengths.max() > _MOST_GROUPS:
        raise ValueError(f"the image has a number of {3 * int(lengths.max())} bits, expected at most 30")
    place = np.arange(len(groups)) - np.repeat(starts, lengths)
    return np.add.reduceat((groups & 7) << (3 * place), starts)
