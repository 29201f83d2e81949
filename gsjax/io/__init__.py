"""Files in and out: data sets, images, point clouds, run folders. Imports pycolmap and OpenCV where used."""
