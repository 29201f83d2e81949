"""Which coordinates of a scene are metres, which way is up, and where on Earth they are counted from.

Photos alone determine none of it. GPS (`gsjax.io.sfm.georeference`) or a known length (`gsjax scale`) does. A
*placed* world is in metres:

    world = scale * rotation @ files + shift

With an origin it is x east, y north, z up (ENU) on the plane that touches WGS 84's ellipsoid at the origin, whose
degrees are float64, and coordinates stay small. `gsjax.scene.similarity` takes the world to local
coordinates.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gsjax.errors import InputError

Vector = tuple[float, float, float]
LARGEST = 1e12  # of scales, both ways, and of shifts: beyond, a file holds no place
METRE, UNKNOWN = "metre", "unknown"  # the units of a world
ENU = ["east", "north", "up"]


@dataclass(frozen=True)
class Place:
    """What is known of a scene's world; by default nothing, and the world is that of the files."""

    known_by: str = ""  # how metres are known, in words; empty: they are not, though up may be
    up: Vector | None = None  # unit vector in the world; None: not known
    origin: tuple[float, float, float | None] | None = None  # degrees north, degrees east, metres (None: not known)
    scale: float = 1.0  # metres in a unit of the data set's files
    rotation: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # rows
    shift: Vector = (0.0, 0.0, 0.0)  # metres

    @property
    def is_known(self) -> bool:
        """Whether the world is in metres."""
        return bool(self.known_by)

    @property
    def moves(self) -> bool:
        """Whether the world's coordinates are other ones than those of the data set's files."""
        return (self.scale, self.rotation, self.shift) != (1.0, Place.rotation, (0.0, 0.0, 0.0))

    @property
    def reached(self) -> Place:
        """The same of files that are in the world's coordinates already."""
        return Place(self.known_by, self.up, self.origin)

    def points_to_world(self, points: np.ndarray) -> np.ndarray:
        """`[..., 3]` positions in the world of those in the files; the same array where these are the same."""
        return self.scale * (points @ np.array(self.rotation).T) + self.shift if self.moves else points

    def directions_to_world(self, directions: np.ndarray) -> np.ndarray:
        """`[..., 3]` directions in the world of those in the files; the same array where these are the same."""
        return directions @ np.array(self.rotation).T if self.moves else directions

    def viewmat_to_world(self, viewmat: np.ndarray) -> np.ndarray:
        """`[4, 4]` float64 world to camera of files to camera; the camera's axes are in metres too."""
        if not self.moves:
            return viewmat
        placed = np.eye(4)
        placed[:3, :3] = viewmat[:3, :3] @ np.array(self.rotation).T
        placed[:3, 3] = self.scale * viewmat[:3, 3] - placed[:3, :3] @ self.shift
        return placed

    def rescale(self, factor: float, known_by: str) -> Place:
        """The same with a metre of the old world `factor` metres long; the origin stays where it is."""
        x, y, z = (factor * side for side in self.shift)
        return replace(self, known_by=known_by, scale=factor * self.scale, shift=(x, y, z))

    def turned(self, rotation: np.ndarray) -> Place:
        """The same with the old world turned by `rotation` `[3, 3]`, after which z is up."""
        first, second, third = (rotation @ np.array(self.rotation)).tolist()
        x, y, z = (rotation @ self.shift).tolist()
        return replace(self, up=(0.0, 0.0, 1.0), rotation=(tuple(first), tuple(second), tuple(third)), shift=(x, y, z))

    def statement(self) -> dict[str, Any]:
        """What a file in the world's coordinates says of them; plain numbers."""
        fields: dict[str, Any] = {"unit": METRE if self.is_known else UNKNOWN, "up": self.up, "known_by": self.known_by}
        if self.origin is not None:
            latitude, longitude, altitude = self.origin
            place = {"latitude": latitude, "longitude": longitude, "altitude": altitude}
            fields |= {"axes": ENU, "origin": place, "datum": "WGS 84"}
        return fields

    def record(self) -> dict[str, Any]:
        """The statement, and the way from the data set's files to the world where that is one."""
        way = {"scale": self.scale, "rotation": self.rotation, "shift": self.shift}
        return self.statement() | ({"from_files": way} if self.moves else {})


UNPLACED = Place()


LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3, "in": 0.0254, "ft": 0.3048}


def parse_length(text: str) -> float:
    """Metres of a length such as `1.25m`, `80cm` or `3ft`.

    Raises:
        ValueError: It is none, or nothing.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?|\.\d+)\s*([a-z]+)", text.strip())
    number = float(match[1]) * LENGTHS.get(match[2], 0.0) if match else 0.0
    if not 0 < number < math.inf:
        raise ValueError(f"{text}: not a length, such as 1.25m, 80cm or 3ft")
    return number


def parse_place(record: Any, where: object) -> Place:
    """The place that a `record`, or a `statement`, holds.

    Raises:
        InputError: It states none; names `where` it was read.
    """
    try:
        origin, move = record.get("origin"), record.get("from_files", {})
        place = Place(
            known_by=str(record["known_by"]),
            up=None if record["up"] is None else _vector(record["up"]),
            origin=None if origin is None else _origin(origin),
            scale=float(move.get("scale", 1.0)),
            rotation=tuple(map(_vector, move.get("rotation", Place.rotation))),
            shift=_vector(move.get("shift", (0.0, 0.0, 0.0))),
        )
        turn = np.array(place.rotation)
        is_turn = turn.shape == (3, 3) and np.abs(turn @ turn.T - np.eye(3)).max() < 1e-6 and np.linalg.det(turn) > 0
        if (
            record["unit"] != (METRE if place.is_known else UNKNOWN)
            or not is_turn
            or not 1 / LARGEST < place.scale < LARGEST
        ):
            raise ValueError
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{where}: states no place of a scene ({str(record)[:80]})") from error
    return place


def _vector(numbers: Any) -> Vector:
    x, y, z = map(float, numbers)
    if not all(abs(number) < LARGEST for number in (x, y, z)):
        raise ValueError
    return x, y, z


def _origin(record: Mapping[str, Any]) -> tuple[float, float, float | None]:
    latitude, longitude = float(record["latitude"]), float(record["longitude"])
    altitude = None if record.get("altitude") is None else float(record["altitude"])
    if not (abs(latitude) <= 90 and abs(longitude) <= 360 and math.isfinite(altitude or 0.0)):
        raise ValueError
    return latitude, longitude, altitude


def up_of_cameras(viewmats: np.ndarray) -> tuple[np.ndarray, float]:
    """Which way is up, if cameras were held level: the direction that their right vectors are least along.

    Args:
        viewmats: `[V, 4, 4]` or `[V, 3, 4]` world to camera, OpenCV axes, of pictures that are upright.

    Returns:
        `[3]` unit vector in the world, and its standard error in radians by how the right vectors scatter: infinite
        where they all point one way, which leaves a rotation about it open.
    """
    rights, downs, forwards = (viewmats[:, row, :3] for row in range(3))
    values, vectors = np.linalg.eigh(rights.T @ rights)
    up = vectors[:, 0]
    # Pictures are on their lower edge; those of a camera that looks straight down are on none.
    if (0.5 * forwards + downs).sum(0) @ up > 0:
        up = -up
    if values[1] < 1e-4 * values[2]:
        mean = -downs.mean(0)
        return mean / np.linalg.norm(mean), math.inf
    return up, math.sqrt(max(values[0], 0.0) / len(rights) / values[1])


def turn_upright(up: np.ndarray) -> np.ndarray:
    """`[3, 3]` the shortest rotation that turns a unit vector `up` to z."""
    x, y, z = up
    if z < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + z)
