"""Unfold a mesh with xatlas, in the process that `gsjax.meshing.atlas` starts: `xatlas_process.py MESH.npz ATLAS.npz`.

In: `vertices` [V, 3] float32 and `faces` [F, 3] uint32 of a mesh whose mean triangle has area 1, `size` and `padding`
in texels. Out: `uvs` [U, 2] in 0..1 of a picture of `width` by `height` texels (only about `size`), `vertices` [U],
`faces` [F, 3] into uvs, number of `charts`.
"""

import sys

import numpy as np
import xatlas

LARGEST_CHART = 1000.0  # Mean triangles; the work grows faster than the size of a chart.
LARGEST_BLOCK = 10_000  # Triangles given to xatlas as one mesh: it crashes on finer ones that close smoothly (a ball).


def main(source: str, target: str) -> None:
    """Reads, unfolds, writes."""
    with np.load(source) as mesh:
        vertices, faces, size, padding = (mesh[name] for name in ("vertices", "faces", "size", "padding"))
    charting, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    charting.max_chart_area = LARGEST_CHART
    packing.resolution, packing.padding = int(size), int(padding)
    atlas = xatlas.Atlas()
    parts = blocks(vertices[faces].mean(axis=1), np.arange(len(faces)))
    for part in parts:
        atlas.add_mesh(vertices, faces[part])
    atlas.generate(charting, packing)
    if atlas.atlas_count != 1:
        raise RuntimeError(f"{atlas.atlas_count} textures instead of one")

    rows, triangles, uvs = zip(*(atlas[index] for index in range(len(parts))), strict=True)
    starts = np.cumsum([0, *map(len, uvs)])
    placed = np.empty_like(faces)
    for part, own, start in zip(parts, triangles, starts[:-1], strict=True):
        placed[part] = own + np.uint32(start)
    np.savez(
        target,
        vertices=np.concatenate(rows),
        faces=placed,
        uvs=np.concatenate(uvs),
        width=atlas.width,
        height=atlas.height,
        charts=atlas.chart_count,
    )


def blocks(centroids: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """The faces cut in halves along their longest side, again and again, until each part is small."""
    if len(faces) <= LARGEST_BLOCK:
        return [faces]
    here = centroids[faces]
    order = np.argsort(here[:, np.argmax(np.ptp(here, axis=0))], kind="stable")
    half = len(faces) // 2
    return blocks(centroids, faces[order[:half]]) + blocks(centroids, faces[order[half:]])


if __name__ == "__main__":
    main(*sys.argv[1:])
