"""A textured mesh as USDZ, which phones open: a scene in USD's text form and the texture, in an archive.

The archive is a ZIP that stores its files as they are, each beginning at a multiple of 64 bytes
(https://openusd.org/release/spec_usdz.html). The material gives off the texture's light and reflects none, because
photos hold their light already.
"""

import zipfile
from io import BytesIO
from pathlib import Path
from string import Template

import numpy as np

from gsjax.meshing.atlas import TexturedMesh
from gsjax.meshing.files.glb import about_offset
from gsjax.scene.georeference import Place

ALIGNMENT = 64
_LOCAL_HEADER = 30  # bytes of a ZIP before a file's name
_PADDING_ID = 0x1986  # Of the extra field that the padding is, and what Pixar's writer names it.
SCENE = Path(__file__).with_name("scene.usda")  # a `string.Template`


def encode_textured(textured: TexturedMesh, _: Place) -> bytes:
    """Return a mesh with its texture as a USDZ: one vertex a place in the texture, v counted from below."""
    from PIL import Image

    atlas, png = textured.atlas, BytesIO()
    Image.fromarray(np.ascontiguousarray(textured.texture)).save(png, "PNG")
    vertices, offset = about_offset(textured.mesh.vertices[atlas.vertices])
    places = atlas.uvs * [1.0, -1.0] + [0.0, 1.0]
    scene = Template(SCENE.read_text("utf-8")).substitute(
        offset=", ".join(f"{value:.17g}" for value in offset),
        extent=_tuples(np.stack([vertices.min(axis=0), vertices.max(axis=0)])),
        counts=", ".join(["3"] * len(atlas.faces)),
        faces=", ".join(map(str, atlas.faces.ravel().tolist())),
        points=_tuples(vertices),
        places=_tuples(places),
    )
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, content in (("scene.usda", scene.encode()), ("texture.png", png.getvalue())):
            info = zipfile.ZipInfo(name)
            info.extra = _padding(stream.tell() + _LOCAL_HEADER + len(name))
            archive.writestr(info, content)
    return stream.getvalue()


def _padding(start: int) -> bytes:
    """The extra field that brings what would begin at `start` to the next multiple of `ALIGNMENT`."""
    size = -start % ALIGNMENT
    size += ALIGNMENT if 0 < size < 4 else 0  # An extra field has 4 bytes at least.
    return _PADDING_ID.to_bytes(2, "little") + (size - 4).to_bytes(2, "little") + bytes(size - 4) if size else b""


def _tuples(values: np.ndarray) -> str:
    row = f"({', '.join(['%.9g'] * values.shape[1])})"
    return ", ".join(row % tuple(value) for value in values.tolist())
