"""One square of four colours, as other programs write it: read right, or in one line that says what is missing."""

import math
from io import BytesIO

import numpy as np
import pytest
from glb_chunks import glb_of
from PIL import Image

from gsjax.meshing import pictures
from gsjax.meshing.export import read_mesh, read_textured

RED, BLUE, GREEN, WHITE = (255, 0, 0), (0, 0, 255), (0, 255, 0), (255, 255, 255)
TEXTURE = np.repeat(np.repeat(np.array([[RED, BLUE], [GREEN, WHITE]], np.uint8), 8, axis=0), 8, axis=1)
SIDE = 5  # vertices
X, Y = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE)))
VERTICES, UVS = np.stack([X, Y, 0 * X], 1), np.stack([X, Y], 1)  # both count from below
QUADS = np.array(
    [[row * SIDE + i + k for k in (0, 1, SIDE + 1, SIDE)] for row in range(SIDE - 1) for i in range(SIDE - 1)]
)
FACES = QUADS[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
PLACES = {RED: (0.2, 0.8), BLUE: (0.8, 0.8), GREEN: (0.2, 0.2), WHITE: (0.8, 0.2)}
CORNERS = {RED: (0, 1), BLUE: (1, 1), GREEN: (0, 0), WHITE: (1, 0)}


def assert_four_colors(path):
    """At the corners of the mesh, and drawn with its texture."""
    mesh, textured = read_mesh(path), read_textured(path)
    for color, corner in CORNERS.items():
        at_corner = (np.abs(mesh.vertices[:, :2] - corner) < 1e-6).all(axis=1)
        assert at_corner.any()
        np.testing.assert_array_equal(mesh.colors[at_corner], [color] * at_corner.sum(), err_msg=str(color))
    assert textured is not None
    assert textured.atlas.uvs.min() >= -1e-4 and textured.atlas.uvs.max() <= 1 + 1e-4, "for writers that do not repeat"
    viewmat = np.array([[1, 0, 0, -0.5], [0, -1, 0, 0.5], [0, 0, -1, 2.0], [0, 0, 0, 1]])
    K, shading = np.array([[100, 0, 32], [0, 100, 32], [0, 0, 1.0]]), pictures.texture_colors(textured)
    image = pictures.render_mesh(textured.mesh, viewmat, K, 64, 64, shading=shading)
    for color, (x, y) in PLACES.items():
        np.testing.assert_array_equal(image[int(32 + 50 * (0.5 - y)), int(32 + 50 * (x - 0.5))], color)


def obj(
    folder,
    *,
    uvs=UVS,
    mtl="newmtl m\nmap_Kd tex.png\n",
    picture="tex.png",
    head="mtllib a.mtl\nusemtl m\n",
    polygons=FACES,
):
    (folder / picture).parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(TEXTURE).save(folder / picture)
    (folder / "a.mtl").write_text(mtl)
    lines = [*("v {} {} {}".format(*vertex) for vertex in VERTICES), *("vt {} {}".format(*uv) for uv in uvs)]
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in polygon) for polygon in polygons]
    (folder / "a.obj").write_text(head + "\n".join(lines) + "\n")
    return folder / "a.obj"


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"polygons": QUADS},
        {"polygons": FACES - len(VERTICES) - 1},  # counted from the last: -25/-25 is the first
        {"uvs": UVS + [1, -2]},
        {"uvs": UVS + [1e-6, -1e-6]},
        {"mtl": "newmtl m\nmap_Kd C:\\Users\\me\\textures\\tex.png\n", "picture": "textures/tex.png"},
        {"mtl": "newmtl m\nmap_Kd /home/me/tex.png\n"},
        {"mtl": 'newmtl m\nmap_Kd "tex.png"\n'},
        {"mtl": "newmtl m\nmap_Kd -blendu on -mm 0 1 -bm 0.5 -clamp on my  tex.png\n", "picture": "my tex.png"},
        {"mtl": "newmtl m\nmap_Kd -s 2 0.5 -o -1 tex.png\n", "uvs": (UVS + [1, 0]) / [2, 0.5]},
        {"mtl": "newmtl m\nmap_Kd -clamp on tex.png\n", "uvs": 3 * UVS - 1},
        {"mtl": "newmtl m\nmap_Kd Tex.PNG\n"},
        {"mtl": "newmtl m\nmap_Kd my%20tex.png\n", "picture": "my tex.png"},
        {"mtl": "\tnewmtl m\r\n\tMap_Kd\ttex.png  \r\n"},
        {"mtl": "newmtl m\nKa 0\nKd 0 0 0\nmap_Ka gone.png\nmap_Kd tex.png\n"},
        {"mtl": "newmtl m\nmap_Ka tex.png\n"},
        {"mtl": "newmtl m\nKd 0 0 0\nKe 1 1 1\nmap_Ke tex.png\n"},
        {"mtl": "\ufeffnewmtl M\nmap_Kd tex.png\n"},
        {"mtl": "newmtl my mat\nmap_Kd tex.png\n", "head": "mtllib a.mtl\nusemtl my mat\n"},
        {"head": "mtllib C:\\scan\\a.mtl\nusemtl m\n"},
        {"head": "mtllib ./A.MTL\nusemtl m\n"},
    ],
)
def test_an_obj_of_another_program_shows_its_texture(tmp_path, capsys, change):
    assert_four_colors(obj(tmp_path, **change))
    assert not capsys.readouterr().err


@pytest.mark.parametrize("name", ["t\u00e4x.png".encode("cp1252"), "t\u00e4x.png".encode(), b"ta\xcc\x88x.png"])
def test_a_picture_with_an_accent_is_found_as_any_program_writes_it(tmp_path, capsys, name):
    path = obj(tmp_path, picture="t\u00e4x.png")
    (tmp_path / "a.mtl").write_bytes(b"newmtl m\nmap_Kd " + name + b"\n")
    assert_four_colors(path)
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"head": "mtllib a.mtl\nusemtl other\n"}, "other, which it names, is in none of its files of materials"),
        ({"head": "mtllib a.mtl\n"}, "tex.png, which it names, belongs to a material of no triangle"),
        ({"mtl": "newmtl m\nmap_Kd gone.png\n"}, "gone.png, which it names, is not in its folder"),
        ({"mtl": "newmtl m\nmap_Kd a.obj\n"}, "a.obj, which it names, is no picture that can be read"),
        ({"mtl": "newmtl m\nmap_Kd ../gone.png\n"}, "../gone.png, which it names, is not in its folder"),
        ({"uvs": 1000 * UVS, "polygons": [(0, 4, 24), (0, 24, 20)]}, "too often to be laid out"),
    ],
)
def test_an_obj_names_the_colours_that_it_does_not_give(tmp_path, capsys, change, line):
    read_mesh(obj(tmp_path, **change))
    messages = [message for message in capsys.readouterr().err.splitlines() if line in message]
    assert len(messages) == 1 and messages[0].endswith("the colours that it would give are missing")


@pytest.mark.parametrize(("shift", "repeats"), [(0, 1), (-3, 3)])
def test_several_textures_become_one(tmp_path, shift, repeats):
    """The halves of the square in pictures of their own, of different sizes; places of a triangle may span tiles."""
    for name, half in (("l", TEXTURE[:, :8]), ("r", np.repeat(TEXTURE[:, 8:], 2, axis=0))):
        Image.fromarray(half).save(tmp_path / f"{name}.png")
    (tmp_path / "a.mtl").write_text("newmtl l\nmap_Kd l.png\nnewmtl r\nmap_Kd r.png\n")
    lines, used = ["mtllib a.mtl", *("v {} {} {}".format(*vertex) for vertex in VERTICES)], 0
    for name, start in (("l", 0.0), ("r", 0.5)):
        lines.append(f"usemtl {name}")
        for face in FACES[np.isclose(VERTICES[FACES, 0].mean(axis=1) > 0.5, start > 0)]:
            lines += [f"vt {repeats * 2 * (VERTICES[k, 0] - start) + shift} {VERTICES[k, 1] - shift}" for k in face]
            used += 3
            lines.append("f " + " ".join(f"{k + 1}/{used - 2 + i}" for i, k in enumerate(face)))
    (tmp_path / "a.obj").write_text("\n".join(lines))
    assert_four_colors(tmp_path / "a.obj")


def test_a_part_of_one_colour_does_not_cost_the_others_their_texture(tmp_path):
    head, lines = obj(tmp_path).read_text().split("f ", 1)
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd tex.png\nnewmtl plain\nKd 0 0.2 1\n")
    (tmp_path / "a.obj").write_text(head + "f " + lines + "v 5 5 0\nv 6 5 0\nv 5 6 0\nusemtl plain\nf -3 -2 -1\n")
    assert_four_colors(tmp_path / "a.obj")
    mesh = read_mesh(tmp_path / "a.obj")
    np.testing.assert_array_equal(mesh.colors[mesh.vertices[:, 0] >= 5], [(0, 51, 255)] * 3)


def glb(folder, *, uvs=UVS, kind="<f4", name="TEXCOORD_0", beside=None, info=None, material=None, mime="image/png",
        mode=4, indices=FACES, sampler=None, node=None, color=None, **tree):  # fmt: skip
    """A GLB by hand: its places count from above."""
    picture = BytesIO()
    Image.fromarray(TEXTURE).save(picture, "WEBP" if mime == "image/webp" else "PNG", lossless=True)
    stored, most = np.asarray(uvs) * [1, -1] + [0, 1], 1 if kind == "<f4" else np.iinfo(kind).max
    columns = {"POSITION": (VERTICES, "<f4"), name: (np.rint(stored * most) if most > 1 else stored, kind)}
    columns |= {} if beside is None else {"TEXCOORD_0": (beside, "<f4")}
    columns |= {} if color is None else {"COLOR_0": (np.tile(color, (len(VERTICES), 1)), "<f4")}
    components = {"<f4": 5126, "u1": 5121, "<u2": 5123}
    blob, views, accessors = b"", [], []

    def view(content, **more):
        nonlocal blob
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(content), **more})
        blob += content + b"\0" * (-len(content) % 4)
        return len(views) - 1

    for values, form in columns.values():
        width, size = values.shape[1], np.dtype(form).itemsize
        rows = np.zeros((len(values), -(-width * size // 4) * 4 // size), form)
        rows[:, :width] = values
        accessors.append({"bufferView": view(rows.tobytes(), byteStride=rows.strides[0]), "count": len(rows),
                          "componentType": components[form], "type": f"VEC{width}",
                          "normalized": form != "<f4"})  # fmt: skip
    flat = np.ravel(indices).astype("<u4")
    accessors.append({"bufferView": view(flat.tobytes()), "count": len(flat), "componentType": 5125, "type": "SCALAR"})
    image = {"bufferView": view(picture.getvalue()), "mimeType": mime}
    primitive = {"attributes": {name: i for i, name in enumerate(columns)}, "indices": len(accessors) - 1}
    content = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, **(node or {})}],
        "meshes": [{"primitives": [{**primitive, "material": 0, "mode": mode}]}], "images": [image],
        "materials": [material or {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **(info or {})}}}],
        "textures": [{"source": 0, **({} if sampler is None else {"sampler": 0})}], "samplers": [sampler or {}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(blob)}], **tree,
    }  # fmt: skip
    (folder / "a.glb").write_bytes(glb_of(content, blob))
    return folder / "a.glb"


def transform(**values):
    return {"extensions": {"KHR_texture_transform": values}}


BASE = {"index": 0}
GLOSSY = {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": BASE}}}
BLACK = {"baseColorFactor": [0, 0, 0, 1]}
STRIP = [k for row in range(SIDE - 1) for i in range(SIDE) for k in ((row + 1) * SIDE + i, row * SIDE + i)]
ENDS = [[STRIP[2 * SIDE * row - 1], STRIP[2 * SIDE * row]] if row else [] for row in range(SIDE - 1)]
STRIPS = [k for row in range(SIDE - 1) for k in (*ENDS[row], *STRIP[2 * SIDE * row : 2 * SIDE * (row + 1)])]


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"uvs": UVS + [1, -2]},
        {"kind": "u1"},
        {"kind": "<u2", "extensionsRequired": ["KHR_mesh_quantization"]},
        {"name": "TEXCOORD_1", "info": {"texCoord": 1}, "beside": UVS[:, ::-1] * 0.1},
        {"name": "TEXCOORD_1", "info": {"texCoord": 0, **transform(texCoord=1)}, "beside": UVS[:, ::-1] * 0.1},
        {"uvs": UVS - 0.5, "info": transform(offset=[0.5, -0.5]), "extensionsRequired": ["KHR_texture_transform"]},
        {"uvs": np.stack([Y - 1, 1 - X], 1), "info": transform(rotation=math.pi / 2)},  # counter-clockwise
        {"uvs": UVS * 2 + [0, -1], "info": transform(scale=[0.5, 0.5])},
        {"material": {**GLOSSY, "pbrMetallicRoughness": BLACK}},
        {"material": {"emissiveFactor": [1, 1, 1], "emissiveTexture": BASE, "pbrMetallicRoughness": BLACK}},
        {"material": {"emissiveFactor": [1, 1, 1], "emissiveTexture": BASE}},
        {"mime": "image/webp", "textures": [{"extensions": {"EXT_texture_webp": {"source": 0}}}]},
        {"node": {"scale": [-1, 1, 1], "translation": [1, 0, 0]}, "uvs": UVS * [-1, 1] + [1, 0]},
        {"mode": 5, "indices": STRIPS},
        {"mode": 6, "indices": [12, *range(5), 9, 14, 19, *range(24, 19, -1), 15, 10, 5, 0]},
        {"sampler": {"wrapS": 33648, "wrapT": 33648}, "uvs": [2, 0] - UVS * [1, -1]},  # mirrored in its second tile
        {"sampler": {"wrapS": 33071, "wrapT": 33071}, "uvs": 3 * UVS - 1},
        {"sampler": {"wrapS": 33071}, "uvs": UVS * [3, 1] + [-1, 1]},  # repeated downwards alone
        {"color": [1.0, 1.0, 1.0]},
    ],
)  # fmt: skip
def test_a_glb_of_another_program_shows_its_texture(tmp_path, capsys, change):
    assert_four_colors(glb(tmp_path, **change))
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"color": [0.5, 1.0, 1.0]}, "COLOR_0, which it names, is not multiplied with its texture"),
        ({"textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}], "images": [{"uri": "gone.ktx2"}]},
         "gone.ktx2, which it names, is not in its folder"),
        ({"images": [{"uri": "data:image/ktx2;base64,AAAA"}]}, "texture 0, which it names, is no picture"),
        ({"textures": [{}]}, "texture 0, which it names, has no picture"),
        ({"materials": [{}, {"pbrMetallicRoughness": {"baseColorTexture": BASE}}]}, "a material of no triangle"),
    ],
)  # fmt: skip
def test_a_glb_names_the_colours_that_it_does_not_give(tmp_path, capsys, change, line):
    read_mesh(glb(tmp_path, **change))
    assert capsys.readouterr().err.count(line) == 1


@pytest.mark.parametrize("corners", [FACES, QUADS])
def test_a_ply_shows_its_texture(tmp_path, capsys, corners):
    """As MeshLab writes it, with places of the texture in the rows of the faces."""
    Image.fromarray(TEXTURE).save(tmp_path / "Tex.png")
    header = ["ply", "format ascii 1.0", "comment TextureFile C:\\scan\\tex.png", f"element vertex {len(VERTICES)}"]
    header += [*(f"property float {axis}" for axis in "xyz"), f"element face {len(corners)}"]
    header += ["property list uchar int vertex_indices", "property list uchar float texcoord", "end_header"]
    rows = ["{} {} {}".format(*vertex) for vertex in VERTICES]
    for face in corners:
        rows.append(f"{len(face)} {' '.join(map(str, face))} {2 * len(face)} {' '.join(map(str, UVS[face].ravel()))}")
    (tmp_path / "a.ply").write_text("\n".join([*header, *rows]) + "\n")
    assert_four_colors(tmp_path / "a.ply")
    (tmp_path / "Tex.png").unlink()
    read_mesh(tmp_path / "a.ply")
    assert "tex.png, which it names, is not in its folder" in capsys.readouterr().err
