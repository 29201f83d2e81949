"""Sixty rendered views of a scanned mesh; `--set normals=SCENE/normals` gives the true normals."""

CONFIG: dict = {}
