"""From which strength are effects detected? Effects are put into the photos of clean scenes, and diagnosed.

    python experiments/effect_detection.py --scene NAME=PATH[@DOWNSCALE] ... [--seeds N]

Every effect has some strengths, the first of which is 0; a detection without the effect is a false positive. The scenes
should have none of the effects. A sky is put over places of its own, which are rendered. Writes
`results/effect_detection.json` and the curves, `docs/assets/effect_detection.png`, and prints the table. Nothing is
trained: `auto` also validates what is proposed.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import records
from records import PICTURES, ROOT
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from gsjax.cli import run_guarded
from gsjax.io.files import atomic_path

NAME = "effect_detection"

Change = Callable[[Any, float, np.random.Generator], Any]
"""(frame, strength, random numbers of its own) -> the frame with the effect; (scene or place, ...) -> the scene."""


class InjectedEffect(NamedTuple):
    """An effect that is put into photos."""

    unit: str
    strengths: tuple[float, ...]
    change: Change


def with_image(frame: Any, change: Callable[[np.ndarray], np.ndarray]) -> Any:
    """A frame whose `[H, W, 3]` image, linear light in 0 to 1, is changed."""
    from gsjax.scene import colors, with_pixels

    pixels = frame.pixels()
    light = np.clip(change(colors.srgb_to_linear(colors.shares(pixels.image))), 0, 1)
    return with_pixels(frame, pixels._replace(image=np.asarray(colors.to_bytes(colors.linear_to_srgb(light)))))


def expose(frame: Any, strength: float, rng: np.random.Generator) -> Any:
    """Another exposure, log-normal between photos; none is brighter, so that nothing is clipped."""
    gain = 2.0 ** -abs(strength * rng.normal())
    return with_image(frame, lambda light: light * gain)


def darken_corners(frame: Any, strength: float, rng: np.random.Generator) -> Any:
    """Light that falls with the square of the distance from the middle, by `strength` EV in the corners."""
    y, x = np.mgrid[: frame.height, : frame.width] + 0.5
    radius2 = (x - frame.width / 2) ** 2 + (y - frame.height / 2) ** 2
    fall = 2.0 ** (-strength * radius2 / radius2.max())
    return with_image(frame, lambda light: light * fall[..., None])


def turn(frame: Any, strength: float, rng: np.random.Generator) -> Any:
    """A camera that is turned by so many pixels about each of its axes, standard deviation."""
    rotation = Rotation.from_rotvec(strength / frame.K[0, 0] * rng.normal(size=3)).as_matrix()
    viewmat = frame.viewmat.copy()
    viewmat[:3] = rotation @ viewmat[:3]
    return replace(frame, viewmat=viewmat.astype(np.float32))


def blur(frame: Any, strength: float, rng: np.random.Generator) -> Any:
    """A fifth of the photos, blurred by a Gaussian of `strength` pixels."""
    from gsjax.io.images import cv2

    if rng.uniform() > 0.2 or not strength:
        return frame
    return with_image(frame, lambda light: cv2.GaussianBlur(light, (0, 0), strength))


def cover(frame: Any, strength: float, rng: np.random.Generator) -> Any:
    """A square of one colour, over that share of the photo's pixels at most."""
    if not strength:
        return frame
    side = int(np.sqrt(strength * frame.width * frame.height))
    x, y = (rng.integers(max(size - side, 0) + 1) for size in (frame.width, frame.height))

    def with_square(light: np.ndarray) -> np.ndarray:
        light = light.copy()
        light[y : y + side, x : x + side] = rng.uniform(size=3)
        return light

    return with_image(frame, with_square)


def under_clouds(place: Any, strength: float, rng: np.random.Generator) -> Any:
    """The scene of a place under clouds of that contrast, turned about the vertical; a contrast of 0 is flat grey."""
    from plain_places import cloudy, flat_grey
    from plain_scenes import photograph

    turned = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))

    def sky(rays: np.ndarray) -> np.ndarray:
        return (1 - strength) * flat_grey(rays) + strength * cloudy(turned.apply(rays))

    return photograph(place._replace(sky=sky))[0]


def in_photos(change: Change) -> Change:
    """The change of a scene that changes each frame, by random numbers of its own."""

    def changed(scene: Any, strength: float, rng: np.random.Generator) -> Any:
        streams = rng.spawn(len(scene.frames))
        frames = (change(frame, strength, stream) for frame, stream in zip(scene.frames, streams, strict=True))
        return replace(scene, frames=tuple(frames))

    return changed


EFFECTS = {
    "exposure": InjectedEffect("EV between photos", (0, 0.02, 0.05, 0.1, 0.2, 0.4), in_photos(expose)),
    "vignetting": InjectedEffect("EV in the corners", (0, 0.05, 0.1, 0.2, 0.4, 0.8), in_photos(darken_corners)),
    "poses": InjectedEffect("pixels", (0, 0.1, 0.2, 0.4, 0.8, 1.6), in_photos(turn)),
    "blur": InjectedEffect("pixels", (0, 0.5, 1, 1.5, 2, 3), in_photos(blur)),
    "transients": InjectedEffect("share of the pixels", (0, 0.05, 0.1, 0.2, 0.4, 0.6), in_photos(cover)),
    "sky": InjectedEffect("contrast of its clouds", (0, 0.05, 0.1, 0.2, 0.5, 1), under_clouds),
}


def run(scenes: Mapping[str, str], seeds: int) -> list[dict[str, Any]]:
    """A row for every scene, effect, strength and seed, with the names of the effects that are detected."""
    from gsjax.planning.effects import diagnose_scene

    places = _places()
    jobs = [
        (name, effect, strength, seed)
        for effect, each in EFFECTS.items()
        for name in (places if effect == "sky" else scenes)
        for strength in each.strengths
        for seed in range(seeds if strength else 1)
    ]
    rows, loaded = records.read(NAME), dict(places)
    done = {(row["scene"], row["effect"], row["strength"], row["seed"]) for row in rows}
    for name, effect, strength, seed in tqdm([job for job in jobs if job not in done], desc="diagnoses", unit="scene"):
        if name not in loaded:
            loaded[name] = _load(scenes[name])
        rng = np.random.default_rng([seed, *effect.encode()])
        effects = diagnose_scene(EFFECTS[effect].change(loaded[name], strength, rng)).record()["effects"]
        detected = [each for each, evidence in effects.items() if evidence["on"]]
        rows.append({"scene": name, "effect": effect, "strength": strength, "seed": seed, "detected": detected})
        records.write(NAME, rows, page_table(rows))
    return rows


def _places() -> dict[str, Any]:
    """Places under an open sky, of those that the tests of skies render."""
    from plain_places import SKIES

    return {"yard": SKIES["a yard, clouds"], "street": SKIES["a street, blue"]}


def _load(scene: str) -> Any:
    from gsjax.io.scenes import load_scene

    path, _, downscale = scene.partition("@")
    return load_scene(path, downscale=float(downscale or 1))


def detections(rows: Sequence[Mapping[str, Any]], effect: str) -> dict[float, tuple[int, int]]:
    """By strength, in how many of so many rows the effect that was put in is detected."""
    counts: dict[float, tuple[int, int]] = {}
    for row in rows:
        if row["effect"] == effect:
            hits, count = counts.get(row["strength"], (0, 0))
            counts[row["strength"]] = hits + (effect in row["detected"]), count + 1
    return counts


def page_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table of the page: a row an effect, with detections by strength and the other effects that were detected."""
    lines = ["| Effect | Unit | Detections by strength | Other effects detected |", "|---|---|---|---|"]
    for effect, each in EFFECTS.items():
        counts = "; ".join(f"{strength:g}: {n} of {of}" for strength, (n, of) in detections(rows, effect).items())
        others = Counter(name for row in rows if row["effect"] == effect for name in row["detected"] if name != effect)
        also = ", ".join(f"`{name}` {n}" for name, n in others.items()) or "none"
        lines.append(f"| `{effect}` | {each.unit} | {counts} | {also} |")
    return "\n".join(lines) + "\n"


def draw(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """A panel an effect: the share of the scenes in which it is detected, against its strength."""
    from gsjax.report.figures import new_figure

    figure = new_figure(7.5, 4.6)
    panels = figure.subplots(2, 3, sharey=True)
    for panel, (effect, each) in zip(panels.flat, EFFECTS.items(), strict=True):
        counts = detections(rows, effect)
        panel.plot(list(counts), [100 * hits / count for hits, count in counts.values()], "o-")
        panel.set(title=effect, xlabel=each.unit)
    for panel in panels[:, 0]:
        panel.set_ylabel("detected, % of the scenes")
    with atomic_path(file) as temporary:
        figure.savefig(temporary, dpi=160, format="png")


def main() -> None:
    """Read the arguments, diagnose, draw, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", required=True, metavar="NAME=PATH[@DOWNSCALE]", help="clean data sets")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="of every strength (default: 3)")
    arguments = parser.parse_args()
    sys.path.append(str(ROOT / "tests"))
    rows = run(dict(each.split("=", 1) for each in arguments.scene), arguments.seeds)
    draw(rows, PICTURES / f"{NAME}.png")
    print(page_table(rows))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
