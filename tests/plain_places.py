"""Places by name: rooms that no sky is in, and places under one."""

import numpy as np
from plain_scenes import Box, Place, lamp, plaster, ring, split, textured, walk

WHITE, BLUE, OCHRE = (0.86, 0.85, 0.82), (0.55, 0.66, 0.85), (0.8, 0.66, 0.42)
LOW, HIGH = (-3.0, -2.5, 0.0), (3.0, 2.5, 2.7)
FURNITURE = (
    Box((-2.9, -2.4, 0), (-1.6, -1.7, 1.2), textured((0.2, 0.1, 0.1), (0.6, 0.4, 0.3))),
    Box((1.4, 1.6, 0), (2.9, 2.4, 1.9), textured((0.1, 0.2, 0.15), (0.4, 0.6, 0.4))),
    Box((1.8, -2.4, 0), (2.8, -1.6, 1.0), textured((0.15, 0.15, 0.3), (0.5, 0.5, 0.7))),
    Box((-2.9, 1.0, 0), (-2.2, 2.3, 1.6), textured((0.3, 0.25, 0.1), (0.7, 0.6, 0.3))),
    Box((-0.6, -0.5, 0), (0.6, 0.5, 0.7), textured()),
)


def is_ceiling(points, axis):
    return (axis == 2) & (points[:, 2] > 1.5)


def room(paint, *, low=LOW, high=HIGH, furniture=FURNITURE, eyes=None) -> Place:
    return Place((Box(low, high, paint, inside=True), *furniture), *(eyes or walk(16, (1.4, 1.1), 1.5)))


def window(points, axis):
    """Daylight from a window at x = 3."""
    return 0.5 + 0.45 * np.exp(-(3.0 - points[:, 0]) / 2.5) * (0.9 + 0.1 * np.cos(points[:, 1]))


def from_above(points, axis):
    """A row of lamps along the top of the walls."""
    return 0.4 + 0.6 * np.exp(-(2.7 - points[:, 2]) / 0.9)


def by_side(points, axis):
    """Every side of the room is lit by itself."""
    return 0.75 + 0.08 * axis + 0.08 * np.sign(points[np.arange(len(points)), axis] - 1)


def ceiling(paint):
    return split(is_ceiling, paint, textured())


def dado(paint, height=1.4):
    return split(lambda points, axis: points[:, 2] < height, textured(), paint)


def floor(paint):
    return split(lambda points, axis: points[:, 2] < 0.02, textured(), paint)


LAMP = lamp((0.8, -0.6, 2.4), 1.2)
TABLE = (Box((-0.25, -0.2, 0.75), (0.25, 0.2, 1.15), textured()), Box((-0.8, -0.6, 0), (0.8, 0.6, 0.75), textured()))
HALL = tuple(
    Box((x, y, 0), (x + 1.2, y + 0.8, h), textured())
    for x, y, h in ((-8, -6, 2.2), (-3, 5, 1.8), (4, -7, 2.5), (6, 4, 3.0), (0, 0, 1.1))
)

ROOMS = {
    "white ceiling": room(ceiling(plaster(WHITE))),
    "white ceiling under a lamp": room(ceiling(plaster(WHITE, LAMP))),
    "white ceiling by a window": room(ceiling(plaster(WHITE, window))),
    "blue ceiling under a lamp": room(ceiling(plaster(BLUE, LAMP))),
    "blue ceiling by a window": room(ceiling(plaster(BLUE, window))),
    "ceiling and high bare walls": room(floor(plaster(WHITE))),
    "ceiling and high bare walls, lamp": room(floor(plaster(WHITE, LAMP))),
    "ceiling and high bare walls, window": room(floor(plaster(WHITE, window))),
    "bare walls lit by side": room(floor(plaster(WHITE, by_side))),
    "bare walls over a dado": room(dado(plaster(WHITE))),
    "bare walls over a dado, lamp": room(dado(plaster(OCHRE, LAMP))),
    "bare walls over a dado, window": room(dado(plaster(BLUE, window))),
    "low bare walls": room(dado(plaster(WHITE, window), 0.9)),
    "bare walls shaded from above": room(dado(plaster(WHITE, from_above))),
    "a white studio": room(floor(plaster((0.95, 0.95, 0.95))), furniture=TABLE, eyes=ring(16, 2.0, 1.5)),
    "a shaded studio": room(floor(plaster(WHITE, from_above)), furniture=TABLE, eyes=ring(16, 2.0, 1.3)),
    "a thing on a table in a bare room": room(
        plaster(WHITE, window), furniture=TABLE, eyes=ring(16, 1.0, 1.3, (0, 0, 1.2))
    ),
    "a hall": room(
        dado(plaster(WHITE, lamp((3, 2, 5), 4.0)), 1.5),
        low=(-10, -8, 0),
        high=(10, 8, 6),
        furniture=HALL,
        eyes=walk(18, (5, 4), 1.6),
    ),
    "a corridor": room(
        split(lambda p, a: (a == 2) & (p[:, 2] > 1), plaster(WHITE, window), textured()),
        low=(-1, -12, 0),
        high=(1, 12, 2.5),
        furniture=(),
        eyes=(
            np.stack([0.3 * np.sin(np.arange(14)), np.linspace(-9, 0, 14), np.full(14, 1.5)], 1),
            np.stack([0.6 * np.sin(2.0 * np.arange(14)), np.linspace(-9, 0, 14) + 3, np.full(14, 1.9)], 1),
        ),
    ),
}


def blue(rays):
    height = np.clip(rays[:, 2:], 0, 1) ** 0.6
    return (1 - height) * np.array([0.80, 0.86, 0.92]) + height * np.array([0.30, 0.50, 0.84])


def overcast(rays):
    """CIE's overcast sky: three times as bright in the zenith as on the horizon."""
    light = (1 + 2 * np.clip(rays[:, 2:], 0, 1)) / 3 * (1 + 0.1 * rays[:, :1])
    return (0.9 * light) ** (1 / 2.2) * np.array([0.97, 0.98, 1.0])


def cloudy(rays):
    x, y, z = rays.T
    cloud = 0.5 / (1 + np.exp(-2.5 * (np.sin(5 * x + 2 * z) + np.sin(6 * y - 4 * z) - 0.4)))[:, None]
    return blue(rays) * (1 - cloud) + 0.93 * cloud


def night(rays):
    return np.full((len(rays), 3), 0.02)


def town_glow(rays):
    return 0.12 + 0.3 * np.exp(-6 * np.clip(rays[:, 2:], 0, 1)) * np.array([1.0, 0.8, 0.5])


def flat_white(rays):
    return np.full((len(rays), 3), 1.0)


def flat_grey(rays):
    return np.full((len(rays), 3), 0.8)


LAWN = Box((-60, -60, -1), (60, 60, 0), textured((0.2, 0.3, 0.1), (0.45, 0.55, 0.25)))
HOUSE = (
    Box((-3, -2, 0), (3, 2, 3), textured()),
    Box((-2.5, -1.5, 3), (2.5, 1.5, 4.2), textured((0.4, 0.15, 0.1), (0.7, 0.35, 0.25))),
    Box((1.2, -0.4, 4.2), (1.8, 0.2, 5.2), textured()),
    Box((4.0, -0.5, 0), (5.2, 1.2, 3.6), textured((0.1, 0.25, 0.1), (0.4, 0.5, 0.25))),
)
STREET = tuple(
    Box((side * 5 - 2.5 + 2.5 * side, y, 0), (side * 5 + 2.5 + 2.5 * side, y + 7.5, h), textured())
    for side, heights in ((-1, (7, 9, 6, 11, 8)), (1, (8, 6, 10, 7, 9)))
    for y, h in zip(range(-10, 30, 8), heights, strict=True)
)


def yard(sky) -> Place:
    return Place((LAWN, *HOUSE), *ring(14, 9.0, 1.6, (0, 0, 2.6), arc=4.2), sky)


def street(sky) -> Place:
    along = np.linspace(-8, 8, 16)
    eyes = np.stack([1.2 * np.sin(np.arange(16)), along, np.full(16, 1.6)], 1)
    ways = np.stack([1.6 * np.sin(1.7 * np.arange(16)), np.full(16, 5.0), np.full(16, 1.6)], 1)
    return Place((LAWN, *STREET), eyes, eyes + ways, sky)


def panes(points, axis):
    """A grid of frames with panes of glass between, 2.2 m wide: negative where there is glass."""
    across = np.where(axis == 0, points[:, 1], points[:, 0])
    is_pane = (np.mod(across, 2.4) > 0.2) & (np.mod(points[:, 2], 3.0) > 0.3) & (axis < 2)
    return np.where(is_pane[:, None], -1.0, textured()(points, axis))


def glass_front(sky, height) -> Place:
    front = Box((-12, 4, 0), (12, 8, height), panes, mirror=True)
    along = np.linspace(-5, 5, 14)
    eyes = np.stack([along, -3 + np.sin(np.arange(14)), np.full(14, 1.6)], 1)
    targets = np.stack(
        [0.6 * along + 2.0 * np.sin(2.0 * np.arange(14)), np.full(14, 4.0), 3.2 + 1.2 * np.cos(np.arange(14))], 1
    )
    return Place((LAWN, front), eyes, targets, sky)


SKIES = {
    "a yard, blue": yard(blue),
    "a yard, clouds": yard(cloudy),
    "a yard, overcast": yard(overcast),
    "a street, overcast": street(overcast),
    "a street, blue": street(blue),
    "a yard, glow of a town at night": yard(town_glow),
    "a low glass front under clouds": glass_front(cloudy, 4.0),
}
DOUBTFUL = {  # A sky that tells nothing from plaster: none is better than a surface that is taken away.
    "a yard, flat grey": yard(flat_grey),
    "a yard, white": yard(flat_white),
    "a yard at night": yard(night),
    "a street, flat grey": street(flat_grey),
}
GLASS = {"a high glass front": glass_front(cloudy, 30.0), "a high glass front, overcast": glass_front(overcast, 30.0)}
