"""The machined part: a chamfered plate with four countersunk holes, a bore and a slot.

Coordinates are the part's own, in millimetres, from the centre of its top
face. Distances are signed: negative in the metal, positive in the air.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LENGTH = 120.0
WIDTH = 84.0
THICKNESS = 10.0
CORNER = 9.0  # radius of the corners
CUT = 13.0  # one corner is cut at 45 degrees, so that the part has one orientation
CHAMFER = 1.3

Coordinate = np.ndarray | float


@dataclass(frozen=True)
class Hole:
    """A through hole: a circle, or a slot if `span` is above zero."""

    name: str
    x: float
    y: float
    radius: float
    sink: float  # width of the cone around the hole
    span: float = 0.0  # distance between the two centres of a slot

    def distance(self, x: Coordinate, y: Coordinate) -> Coordinate:
        """Distance from the hole's wall, negative inside the hole."""
        along = np.maximum(np.abs(y - self.y) - self.span / 2, 0.0)
        return np.hypot(x - self.x, along) - self.radius


HOLES = (
    Hole("corner 1", -47.0, -29.0, 4.8, 2.8),
    Hole("corner 2", 47.0, -29.0, 4.8, 2.8),
    Hole("corner 3", 47.0, 29.0, 4.8, 2.8),
    Hole("corner 4", -47.0, 29.0, 4.8, 2.8),
    Hole("bore", -10.0, 0.0, 14.0, 1.0),
    Hole("slot", 30.0, 0.0, 5.0, 1.0, span=20.0),
)

RECESS = 20.5  # radius of the turned recess around the bore
RECESS_DEPTH = 1.2


def to_part(x: Coordinate, y: Coordinate, px: float, py: float, angle: float) -> tuple[Coordinate, Coordinate]:
    """Converts a point of the belt to the coordinates of a part that lies at (px, py) and is rotated by `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    dx, dy = x - px, y - py
    return c * dx + s * dy, -s * dx + c * dy


def outline_distance(x: Coordinate, y: Coordinate) -> Coordinate:
    """Distance from the plate's outline, negative inside. Holes are ignored."""
    qx = np.abs(x) - (LENGTH / 2 - CORNER)
    qy = np.abs(y) - (WIDTH / 2 - CORNER)
    box = np.hypot(np.maximum(qx, 0), np.maximum(qy, 0)) + np.minimum(np.maximum(qx, qy), 0) - CORNER
    corner = (x - y - (LENGTH + WIDTH) / 2 + CUT) / np.sqrt(2)
    return np.maximum(box, corner)


def distance(x: Coordinate, y: Coordinate, missing_hole: str | None = None) -> Coordinate:
    """Distance from the nearest edge of the top face, negative on the metal. The hole `missing_hole` does not exist."""
    found = outline_distance(x, y)
    for hole in HOLES:
        if hole.name != missing_hole:
            found = np.maximum(found, -hole.distance(x, y))
    return found


def edge_point(along: float, side: int) -> tuple[float, float]:
    """A point in the straight middle of one of the four sides: `along` is 0 at one end of it, 1 at the other."""
    t = (along - 0.5) * 0.6
    return (
        (t * LENGTH, -WIDTH / 2),
        (LENGTH / 2, t * WIDTH),
        (t * LENGTH, WIDTH / 2),
        (-LENGTH / 2, t * WIDTH),
    )[side]
