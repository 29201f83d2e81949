"""A textured mesh as USDZ, which phones open: a scene in USD's text form and the texture, in an archive.

The archive is a ZIP that stores its files as they are, each beginning at a multiple of 64 bytes
(https://openusd.org/release/spec_usdz.html). The material gives off the texture's light and reflects none, because
photos hold their light already.
"""

import zipfile
from io import BytesIO

import numpy as np

from gsjax.meshing.atlas import TexturedMesh
from gsjax.meshing.files.glb import about_offset
from gsjax.scene.georeference import Place

ALIGNMENT = 64
_LOCAL_HEADER = 30  # bytes of a ZIP before a file's name
_PADDING_ID = 0x1986  # Of the extra field that the padding is, and what Pixar's writer names it.
_SCENE = """#usda 1.0
(
    defaultPrim = "Scene"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Scene" (
    kind = "component"
)
{{
    double3 xformOp:translate = ({offset})
    uniform token[] xformOpOrder = ["xformOp:translate"]

    def Mesh "Surface" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 1
        float3[] extent = [{extent}]
        int[] faceVertexCounts = [{counts}]
        int[] faceVertexIndices = [{faces}]
        rel material:binding = </Scene/Material>
        point3f[] points = [{points}]
        texCoord2f[] primvars:st = [{places}] (
            interpolation = "vertex"
        )
        uniform token subdivisionScheme = "none"
    }}

    def Material "Material"
    {{
        token outputs:surface.connect = </Scene/Material/Surface.outputs:surface>

        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0, 0, 0)
            color3f inputs:emissiveColor.connect = </Scene/Material/Texture.outputs:rgb>
            float inputs:metallic = 0
            float inputs:roughness = 1
            token outputs:surface
        }}

        def Shader "Places"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}

        def Shader "Texture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @texture.png@
            token inputs:sourceColorSpace = "sRGB"
            float2 inputs:st.connect = </Scene/Material/Places.outputs:result>
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float3 outputs:rgb
        }}
    }}
}}
"""


def encode_textured(textured: TexturedMesh, _: Place) -> bytes:
    """Return a mesh with its texture as a USDZ: one vertex a place in the texture, v counted from below."""
    from PIL import Image

    atlas, png = textured.atlas, BytesIO()
    Image.fromarray(np.ascontiguousarray(textured.texture)).save(png, "PNG")
    vertices, offset = about_offset(textured.mesh.vertices[atlas.vertices])
    places = atlas.uvs * [1.0, -1.0] + [0.0, 1.0]
    scene = _SCENE.format(
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
