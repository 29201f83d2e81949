"""One square of four colours, as other programs write it: read right, or in one line that says what is missing."""

from io import BytesIO

import numpy as np
import pytest
from glb_chunks import glb_of
from PIL import Image

from gsjax.errors import InputError
from gsjax.meshing import pictures
from gsjax.meshing.export import read_mesh, read_textured
from gsjax.scene.cameras import Camera

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
    image = pictures.render_mesh(textured.mesh, Camera(viewmat, K, 64, 64), shading=shading)
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
        {"mtl": "newmtl m\nmap_Kd Tex.PNG\n"},
        {"mtl": "newmtl m\nmap_Kd my%20tex.png\n", "picture": "my tex.png"},
        {"mtl": "\tnewmtl m\r\n\tMap_Kd\ttex.png  \r\n"},
        {"mtl": "newmtl m\nKa 0\nKd 0 0 0\nmap_Ka gone.png\nmap_Kd tex.png\n"},
        {"mtl": "\ufeffnewmtl m\nmap_Kd tex.png\n"},
        {"mtl": "newmtl my mat\nmap_Kd tex.png\n", "head": "mtllib a.mtl\nusemtl my mat\n"},
        {"head": "mtllib C:\\scan\\a.mtl\nusemtl m\n"},
        {"head": "mtllib ./A.MTL\nusemtl m\n"},
    ],
)
def test_an_obj_of_another_program_shows_its_texture(tmp_path, capsys, change):
    assert_four_colors(obj(tmp_path, **change))
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"head": "mtllib a.mtl\nusemtl other\n"}, "other, which it names, is in none of its files of materials"),
        ({"head": "mtllib a.mtl\n"}, "tex.png, which it names, belongs to a material of no triangle"),
        ({"mtl": "newmtl m\nmap_Kd gone.png\n"}, "gone.png, which it names, is not in its folder"),
        ({"mtl": "newmtl m\nmap_Kd a.obj\n"}, "a.obj, which it names, is not read as a picture of its triangles"),
        ({"mtl": "newmtl m\nmap_Ke tex.png\n"}, "tex.png, which it names, is not read as a picture of its triangles"),
        ({"mtl": "newmtl m\nmap_Kd ../gone.png\n"}, "../gone.png, which it names, is not in its folder"),
        ({"mtl": "newmtl m\nmap_Kd -s 2 2 tex.png\n"}, "-s 2 2 tex.png, which it names, has options that are not read"),
        ({"head": "mtllib a.mtl\nmtllib b.mtl\nusemtl m\n"}, "b.mtl, which it names, is not read after the first"),
    ],
)
def test_an_obj_names_the_colours_that_it_does_not_give(tmp_path, capsys, change, line):
    read_mesh(obj(tmp_path, **change))
    messages = [message for message in capsys.readouterr().err.splitlines() if line in message]
    assert len(messages) == 1 and messages[0].endswith("the colours that it would give are missing")


def several(folder):
    """The halves of the square in pictures of their own, and a triangle of one colour."""
    for name, half in (("l", TEXTURE[:, :8]), ("r", TEXTURE[:, 8:])):
        Image.fromarray(half).save(folder / f"{name}.png")
    materials = "newmtl l\nmap_Kd l.png\nnewmtl r\nmap_Kd r.png\nnewmtl plain\nKd 0 0.2 1\n"
    is_right = VERTICES[FACES, 0].mean(axis=1) > 0.5
    path = obj(folder, uvs=UVS * [2, 1], mtl=materials, head="mtllib a.mtl\n", polygons=FACES[np.argsort(is_right)])
    lines = path.read_text().splitlines()
    lines[-len(FACES) : -len(FACES)] = ["usemtl l"]
    lines[-len(FACES) // 2 : -len(FACES) // 2] = ["usemtl r"]
    path.write_text("\n".join([*lines, "v 5 5 0", "v 6 5 0", "v 5 6 0", "usemtl plain", "f 26 27 28"]))
    return path


@pytest.mark.parametrize(
    ("file", "line"),
    [
        (several, "only a mesh with one texture keeps it"),
        (lambda folder: obj(folder, uvs=UVS * [3, 1]), "its texture repeats"),
    ],
)
def test_what_is_not_one_texture_becomes_colours_of_vertices(tmp_path, capsys, file, line):
    path = file(tmp_path)
    mesh = read_mesh(path)
    assert read_textured(path) is None
    for color, corner in CORNERS.items():
        at_corner = (np.abs(mesh.vertices[:, :2] - corner) < 1e-6).all(axis=1)
        np.testing.assert_array_equal(mesh.colors[at_corner], [color] * at_corner.sum())
    assert (mesh.colors[mesh.vertices[:, 0] >= 5] == (0, 51, 255)).all()
    assert capsys.readouterr().err.count(f"{line}; it is read with colours of vertices") == 1


def glb(folder, *, uvs=UVS, kind="<f4", info=None, material=None, mime="image/png",
        mode=4, indices=FACES, sampler=None, node=None, color=None, **tree):  # fmt: skip
    """A GLB by hand: its places count from above."""
    picture = BytesIO()
    Image.fromarray(TEXTURE).save(picture, "WEBP" if mime == "image/webp" else "PNG", lossless=True)
    stored, most = np.asarray(uvs) * [1, -1] + [0, 1], 1 if kind == "<f4" else np.iinfo(kind).max
    columns = {"POSITION": (VERTICES, "<f4"), "TEXCOORD_0": (np.rint(stored * most) if most > 1 else stored, kind)}
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
        {"material": {"emissiveFactor": [1, 1, 1], "emissiveTexture": BASE, "pbrMetallicRoughness": BLACK}},
        {"material": {"emissiveFactor": [1, 1, 1], "emissiveTexture": BASE}},
        {"mime": "image/webp", "textures": [{"extensions": {"EXT_texture_webp": {"source": 0}}}]},
        {"node": {"scale": [-1, 1, 1], "translation": [1, 0, 0]}, "uvs": UVS * [-1, 1] + [1, 0]},
        {"mode": 5, "indices": STRIPS},
        {"sampler": {"wrapS": 33071, "wrapT": 33071}},
        {"color": [1.0, 1.0, 1.0]},
    ],
)  # fmt: skip
def test_a_glb_of_another_program_shows_its_texture(tmp_path, capsys, change):
    assert_four_colors(glb(tmp_path, **change))
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"kind": "u1"}, "places in integers"),
        ({"kind": "<u2", "extensionsRequired": ["KHR_mesh_quantization"]}, "KHR_mesh_quantization"),
        ({"info": {"texCoord": 1}}, "TEXCOORD_1"),
        ({"info": {"extensions": {"KHR_texture_transform": {}}}}, "KHR_texture_transform"),
        ({"material": {**GLOSSY, "pbrMetallicRoughness": BLACK}}, "KHR_materials_pbrSpecularGlossiness"),
        ({"mode": 6}, "a fan of triangles"),
        ({"sampler": {"wrapS": 33071}, "uvs": 3 * UVS - 1}, "shows a texture beyond its border"),
        ({"nodes": [{"camera": 0, "children": [1]}, {"mesh": 0}]}, "a camera that holds a mesh"),
    ],
)  # fmt: skip
def test_a_glb_that_trimesh_would_read_wrong_is_refused(tmp_path, change, fault):
    with pytest.raises(InputError, match=f"a.glb: .*{fault}.*, which is not read"):
        read_mesh(glb(tmp_path, **change))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"color": [0.5, 1.0, 1.0]}, "COLOR_0, which it names, is not multiplied with its texture"),
        ({"textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}], "images": [{"uri": "gone.ktx2"}]},
         "texture 0, which it names, is no picture"),
        ({"textures": [{}]}, "texture 0, which it names, is no picture"),
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
