"""What wrong normals do on a scanned mesh on a plane: `wrong_normals.py` there, timed as `baselines_bunny_front.py`."""

from studies.baselines_bunny_front import CONFIG as BASELINES
from studies.wrong_normals import with_maps

CONFIG: dict = {"base": "bunny_plane", "variants": with_maps(BASELINES["variants"])}
