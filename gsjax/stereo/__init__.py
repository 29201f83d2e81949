"""Depth of photos from one another: a plane sweep, smoothed, and kept where photos confirm each other.

A fast estimate of what is between the points of structure from motion: training may start there, and a mesh be made of
it. It needs tracks: they say which photos see the same things, at which depths to look, and whether what was found is
right.
"""

from gsjax.stereo.depths import PhotoDepths, StereoPoints, depths_of_photos, stereo_points
from gsjax.stereo.maps import StereoMap, StereoMaps, read_stereo_maps, stereo_maps, witnessed_normals, write_stereo_maps

__all__ = [
    "PhotoDepths",
    "StereoMap",
    "StereoMaps",
    "StereoPoints",
    "depths_of_photos",
    "read_stereo_maps",
    "stereo_maps",
    "stereo_points",
    "witnessed_normals",
    "write_stereo_maps",
]
