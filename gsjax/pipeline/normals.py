"""Normal maps for a data set's photos, from a network that the user has as an ONNX file."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from gsjax import config
from gsjax.errors import InputError
from gsjax.io import normal_folders
from gsjax.io.files import folder_if_used
from gsjax.io.normal_maps import map_places
from gsjax.io.scenes import load_scene
from gsjax.networks.estimators import DepthEstimator, DepthNormals, NormalEstimator
from gsjax.networks.records import DEPTH_NETWORKS, NETWORKS, DepthNetwork, NormalNetwork, read_record
from gsjax.normals.axes import axes_verdict, facing_votes
from gsjax.normals.fitted_depth import DepthFit
from gsjax.planning.sizes import chosen_downscale
from gsjax.scene import Frame, Scene
from gsjax.settings import Photos

MOST_NAMED = 5  # rejected photos that a report names


def normals(
    scene: str | Path,
    network: str | Path,
    weights: str | Path,
    out: str | Path | None = None,
    *,
    downscale: float | None = None,
    images: str | None = None,
) -> dict[str, Any]:
    """Estimate a normal map for every photo; those that the same model made before are kept.

    The network sees the frames as training does, undistorted, one at a time. Maps have the frames' size. What a network
    for depth sees is fitted to the tracks of every photo first; where that fails, its map is zero.

    Args:
        scene: Folder of the data set, see `gsjax.io.scenes.load_scene`.
        network: A name of `gsjax.networks.records.NETWORKS` or `DEPTH_NETWORKS`, or a JSON file with a record of one's
            own.
        weights: The network as an ONNX file.
        out: Folder of the maps, see `gsjax.io.normal_folders`. None: `normals_NETWORK` in the data set, where NETWORK
            is the name, or the file's without its suffix.
        downscale: Frames are this many times smaller, at least 1. None: their longer side becomes 1,600 pixels where
            it is longer, as in training.
        images: Folder of the photos, absolute or in `scene`. None: searched for.

    Returns:
        `maps`, and `made`: how many there are, and how many of them are new; `known`: mean share of pixels that have a
        normal; `axes`: what the maps themselves say for the record's axes, or of a network for depth `fit`: how well it
        fits the tracks, and `rejected`: the photos where it does not, and why; `provider`: what the network ran on, as
        onnxruntime calls it; `seconds_per_map` (None where nothing was new); `licence`; `folder`.

    Raises:
        InputError: The data set, the record, the weights or the folder cannot be used. Maps that were whole by then
            stay, and the next run continues with the rest.
    """
    name, record = read_network(network)
    is_depth = isinstance(record, DepthNetwork)
    estimator = DepthEstimator(record, weights) if is_depth else NormalEstimator(record, weights)
    loaded, downscale = _load(scene, images, downscale)
    estimate = DepthNormals(estimator, loaded) if is_depth else lambda frame: (estimator(frame), None)
    folder = Path(scene) / f"{normal_folders.PREFIX}{name}" if out is None else Path(out)
    photos = {"downscale": downscale, "images": images}
    made_by = {"network": name, "sha256": estimator.graph.sha256, "record": config.to_dict(record), **photos}
    with folder_if_used(folder):
        manifest = normal_folders.begin(folder, made_by)
        missing = _missing(folder, manifest, loaded.frames)
        began, places = time.perf_counter(), map_places(loaded.frames)
        for frame in tqdm(missing, desc=f"{name} on {estimator.graph.device}", unit="photo", leave=bool(missing)):
            normal_map, fit = estimate(frame)
            file = Path(f"{places[frame.name]}.npz")
            normal_folders.add(folder, manifest, frame.name, file, normal_map, _about(frame, normal_map, fit))
        seconds = time.perf_counter() - began
    maps = {frame.name: manifest["maps"][frame.name] for frame in loaded.frames}
    return {
        "maps": len(maps),
        "made": len(missing),
        "known": float(np.mean([one["known"] for one in maps.values()])),
        **(_fits(maps) if is_depth else _axes(maps)),
        "provider": estimator.graph.provider,
        "seconds_per_map": seconds / len(missing) if missing else None,
        "licence": record.licence,
        "folder": str(folder),
    }


def _load(scene: str | Path, images: str | None, downscale: float | None) -> tuple[Scene, float]:
    """The data set at the size of its maps, and how many times smaller that is."""
    loaded = load_scene(scene, images=images)
    # Not asking jax for its device: a GPU's memory is the network's here.
    factor = chosen_downscale(Photos(downscale=downscale), loaded.frames, on_cpu=False)
    return loaded if factor == 1 else load_scene(scene, downscale=factor, images=images), factor


def read_network(network: str | Path) -> tuple[str, NormalNetwork | DepthNetwork]:
    """A network's name and record.

    Raises:
        InputError: It is neither a known name nor a file, or the file is no such record; names the key.
    """
    networks: dict[str, NormalNetwork | DepthNetwork] = {**NETWORKS, **DEPTH_NETWORKS}
    return read_record(network, networks, lambda data: DepthNetwork if "kind" in data else NormalNetwork)


def _missing(folder: Path, manifest: Mapping[str, Any], frames: tuple[Frame, ...]) -> list[Frame]:
    """The frames without a whole map of theirs."""
    missing = []
    for frame in frames:
        done = manifest["maps"].get(frame.name)
        if done is None or not (folder / done["file"]).is_file():
            missing.append(frame)
        elif done["camera"] != _camera(frame):
            raise InputError(
                f"{folder}: the camera of {frame.name} has changed since its map was made; choose another folder "
                "with --out"
            )
    return missing


def _about(frame: Frame, normal_map: np.ndarray, fit: DepthFit | None) -> dict[str, Any]:
    """What the manifest holds of a map."""
    about = {"camera": _camera(frame), "known": round(float(np.any(normal_map, axis=-1).mean()), 4)}
    if fit is None:
        return about | {"votes": facing_votes(normal_map, frame.K).tolist()}
    # JSON has no infinity: the error of a photo without points.
    numbers = {name: value for name, value in fit._asdict().items() if np.isfinite(value)}
    return about | {"fit": numbers, "rejected": fit.fault}


def _axes(maps: Mapping[str, Any]) -> dict[str, str]:
    """What the maps themselves say for the record's axes."""
    return {"axes": axes_verdict(np.sum([one["votes"] for one in maps.values()], axis=0))}


def _fits(maps: Mapping[str, Any]) -> dict[str, str]:
    """How well a network for depth fits the tracks, and which photos it does not fit."""
    rejected = [(name, why) for name, one in maps.items() if (why := one["rejected"])]
    fits = [one["fit"] for one in maps.values() if not one["rejected"]]
    summary = "none"
    if fits:
        error, explained = (np.median([fit[name] for fit in fits]) for name in ("error", "explained"))
        summary = f"{100 * error:.1f} % off the tracks' depth, explains {explained:.2f} of it (medians)"
    named = "; ".join(f"{name} ({why})" for name, why in rejected[:MOST_NAMED])
    more = f"; and {len(rejected) - MOST_NAMED} more" if len(rejected) > MOST_NAMED else ""
    return {"fit": summary, "rejected": f"{len(rejected)} of {len(maps)}" + (f": {named}{more}" if rejected else "")}


def _camera(frame: Frame) -> list[float]:
    """What of a frame decides its map, in addition to the photo: its size and intrinsics."""
    return [frame.width, frame.height, *(round(float(k), 4) for k in frame.K.reshape(-1))]
