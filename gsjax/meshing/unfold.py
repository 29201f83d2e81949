"""Unfolds a mesh with xatlas: `python unfold.py MESH.npz ATLAS.npz`. What `gsjax.meshing.atlas` starts, to survive it.

In: `vertices` [V, 3] float32, `faces` [F, 3] uint32, `size` and `padding` in texels. Out: `uvs` [U, 2] in 0..1 of a
picture of `width` by `height` texels (only about `size`), `vertices` [U], `faces` [F, 3] into uvs, number of `charts`.
"""

import sys

import numpy as np
import xatlas


def main(source: str, target: str) -> None:
    """Reads, unfolds, writes."""
    with np.load(source) as mesh:
        vertices, faces, size, padding = (mesh[name] for name in ("vertices", "faces", "size", "padding"))
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding = int(size), int(padding)
    atlas = xatlas.Atlas()
    atlas.add_mesh(vertices, faces)
    atlas.generate(pack_options=packing)
    rows, triangles, uvs = atlas[0]
    np.savez(
        target,
        vertices=rows,
        faces=triangles,
        uvs=uvs,
        width=atlas.width,
        height=atlas.height,
        charts=atlas.chart_count,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
