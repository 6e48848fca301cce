"""The contents of one picture: all random choices, except the grain of surfaces and the noise of the sensor.

A scene depends only on a seed and a label. It does not depend on the size
of the picture, so the same scene can be drawn at any width. Lengths are in
millimetres, angles in radians, brightness in linear light (1.0 = white).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import part

LABELS = ("good", "scratched", "dented", "hole missing")

SURFACES = ("brushed", "milled", "blasted")

# Linear-light colours of belts that are common on such lines.
BELTS = (
    (0.020, 0.058, 0.040),  # green PVC
    (0.030, 0.031, 0.033),  # black rubber
    (0.090, 0.092, 0.092),  # grey PU
    (0.022, 0.050, 0.105),  # blue PU
)

# Linear-light colours of the metal.
METALS = (
    (0.76, 0.77, 0.78),  # aluminium
    (0.62, 0.62, 0.61),  # steel
    (0.70, 0.69, 0.66),  # zinc-plated steel
)


@dataclass(frozen=True)
class Pose:
    """A part on the belt: the centre's position in mm, the rotation in radians."""

    x: float
    y: float
    angle: float


@dataclass(frozen=True)
class Light:
    """The light: direction, distance and colour of the lamp, and the share of ambient light."""

    azimuth: float
    elevation: float
    distance: float  # mm
    temperature: float  # -1 cool .. +1 warm
    ambient: float
    softness: float  # mm of penumbra per mm of height


@dataclass(frozen=True)
class Camera:
    """The camera: its view of the belt, and the quality of its picture."""

    view: float  # mm of belt across the picture's width
    tilt: float
    tilt_direction: float
    distance: float  # mm
    blur: float  # px at 1280
    motion: float  # px at 1280, along the belt
    noise: float  # about the standard deviation at mid grey; white is 255
    exposure: float  # brightness of the part's face, linear
    vignette: float
    sharpen: float


@dataclass(frozen=True)
class Scratch:
    """A groove along a line of points, in the part's own millimetres."""

    points: np.ndarray  # [n, 2]
    width: float  # mm
    depth: float  # relative, 0..1
    bright: float  # change of reflectance in the groove, -1..1


@dataclass(frozen=True)
class Dent:
    """A hollow that an impact left. If it `is_at_edge`, the impact also pushed the outline in."""

    x: float
    y: float
    radius: float  # mm
    depth: float  # mm
    stretch: float  # ratio of length to width
    angle: float
    is_at_edge: bool


@dataclass(frozen=True)
class Scene:
    """One picture's contents."""

    seed: int
    label: str
    pose: Pose
    neighbour: Pose | None
    light: Light
    camera: Camera
    belt: tuple[float, float, float]
    metal: tuple[float, float, float]
    surface: str
    grain: float  # strength of the machining marks
    rail: float | None  # y of a guide rail's edge in mm; the sign tells on which side of the belt the rail is
    seam: float | None  # x of the belt's seam in mm
    shavings: int
    dust: int
    fasteners: tuple[tuple[float, float, float, str], ...]  # x, y, angle, kind
    missing_hole: str | None = None
    scratches: tuple[Scratch, ...] = ()
    dents: tuple[Dent, ...] = ()


def sample(seed: int, label: str) -> Scene:
    """The scene that belongs to `seed` and `label`."""
    if label not in LABELS:
        raise ValueError(f"unknown label {label!r}; known: {LABELS}")
    rng = np.random.default_rng([seed, LABELS.index(label)])
    camera = _camera(rng)
    pose = _pose(rng, camera)
    surface = str(rng.choice(SURFACES, p=(0.45, 0.4, 0.15)))
    belt = np.array(BELTS[rng.choice(len(BELTS), p=(0.4, 0.25, 0.15, 0.2))]) * rng.uniform(0.7, 1.5)
    return Scene(
        seed=seed,
        label=label,
        pose=pose,
        neighbour=_neighbour(rng, pose),
        light=_light(rng),
        camera=camera,
        belt=tuple(belt * rng.uniform(0.93, 1.07, 3)),
        metal=METALS[rng.integers(len(METALS))],
        surface=surface,
        grain=rng.uniform(0.5, 1.2),
        rail=float(rng.choice((-1, 1)) * rng.uniform(66, 84)) if rng.random() < 0.4 else None,
        seam=rng.uniform(-100, 100) if rng.random() < 0.12 else None,
        shavings=int(rng.integers(0, 16)) if rng.random() < 0.7 else 0,
        dust=int(rng.integers(20, 220)),
        fasteners=_fasteners(rng, pose),
        missing_hole=_missing_hole(rng) if label == "hole missing" else None,
        scratches=_scratches(rng) if label == "scratched" else (),
        dents=_dents(rng) if label == "dented" else (),
    )


def _camera(rng: np.random.Generator) -> Camera:
    return Camera(
        view=rng.uniform(170, 204),
        tilt=np.radians(rng.uniform(0, 15)),
        tilt_direction=rng.uniform(0, 2 * np.pi),
        distance=rng.uniform(420, 800),
        blur=rng.uniform(0.3, 1.3),
        motion=rng.uniform(1, 6) if rng.random() < 0.3 else 0.0,
        noise=rng.uniform(0.8, 3.0),
        exposure=rng.uniform(0.24, 0.50),
        vignette=rng.uniform(0.05, 0.45),
        sharpen=rng.uniform(0.0, 0.6),
    )


def _light(rng: np.random.Generator) -> Light:
    return Light(
        azimuth=rng.uniform(0, 2 * np.pi),
        elevation=np.radians(rng.uniform(38, 68)),
        distance=rng.uniform(320, 900),
        temperature=rng.uniform(-0.8, 1.0),
        ambient=rng.uniform(0.25, 0.6),
        softness=rng.uniform(0.08, 0.5),
    )


def _pose(rng: np.random.Generator, camera: Camera) -> Pose:
    # The part fits into 142 x 114 mm at each angle below.
    room_x, room_y = (camera.view - 142) / 2, (0.75 * camera.view - 114) / 2
    turn = np.pi if rng.random() < 0.5 else 0.0
    return Pose(
        x=rng.uniform(-1, 1) * room_x,
        y=rng.uniform(-1, 1) * room_y,
        angle=turn + np.radians(np.clip(rng.normal(0, 8), -16, 16)),
    )


def _neighbour(rng: np.random.Generator, pose: Pose) -> Pose | None:
    """The part before or after the inspected part on the belt; most of it is outside of the picture."""
    if rng.random() > 0.35:
        return None
    side = rng.choice((-1, 1))
    return Pose(
        x=pose.x + side * rng.uniform(142, 160),
        y=rng.uniform(-8, 8),
        angle=np.radians(rng.normal(0, 6)) + rng.choice((0.0, np.pi)),
    )


def _fasteners(rng: np.random.Generator, pose: Pose) -> tuple[tuple[float, float, float, str], ...]:
    """Loose screws, nuts and washers; none lies on the part."""
    found = []
    for _ in range(rng.choice((0, 1, 2, 3), p=(0.55, 0.25, 0.13, 0.07))):
        x, y = rng.uniform(-100, 100), rng.uniform(-75, 75)
        if part.outline_distance(*part.to_part(x, y, pose.x, pose.y, pose.angle)) > 12:
            kind = str(rng.choice(("screw", "nut", "washer"), p=(0.6, 0.25, 0.15)))
            found.append((x, y, rng.uniform(0, 2 * np.pi), kind))
    return tuple(found)


def _missing_hole(rng: np.random.Generator) -> str:
    return str(rng.choice([hole.name for hole in part.HOLES]))


def _face_point(rng: np.random.Generator, margin: float) -> tuple[float, float]:
    """A random point on the top face, at least `margin` mm from any edge."""
    while True:
        x = rng.uniform(-part.LENGTH / 2, part.LENGTH / 2)
        y = rng.uniform(-part.WIDTH / 2, part.WIDTH / 2)
        if part.distance(x, y) < -margin:
            return x, y


def _scratches(rng: np.random.Generator) -> tuple[Scratch, ...]:
    """One to four grooves; most have about the same direction, as after a part has slid over an edge."""
    count = int(rng.choice((1, 2, 3, 4), p=(0.3, 0.3, 0.25, 0.15)))
    heading = rng.uniform(0, np.pi)
    bright = rng.uniform(0.5, 1.0) if rng.random() < 0.65 else -rng.uniform(0.5, 0.75)
    x, y = _face_point(rng, 3.0)
    found = []
    for index in range(count):
        if index and rng.random() < 0.4:
            x, y = _face_point(rng, 3.0)
        length = rng.uniform(32, 85)
        angle = heading + rng.normal(0, 0.12)
        bend = rng.normal(0, 0.006)
        steps = np.linspace(-length / 2, length / 2, 48)
        angles = angle + bend * steps + np.cumsum(rng.normal(0, 0.012, steps.size))
        stride = steps[1] - steps[0]
        px = x + np.cumsum(np.cos(angles) * stride) - np.cos(angle) * length / 2
        py = y + np.cumsum(np.sin(angles) * stride) - np.sin(angle) * length / 2
        points = np.stack([px, py], axis=1)
        on_face = part.distance(px, py) < -0.5
        if on_face.mean() < 0.5 or on_face.sum() * stride < 22:
            found += _scratches(rng)[:1]  # too little of this groove is on the face: another one takes its place
        else:
            found.append(Scratch(points, rng.uniform(0.7, 1.3), rng.uniform(0.75, 1.0), bright))
        x, y = x + rng.normal(0, 6), y + rng.normal(0, 6)
    return tuple(found)


def _dents(rng: np.random.Generator) -> tuple[Dent, ...]:
    """One or two hollows on the face or at an edge."""
    found = []
    for _ in range(int(rng.choice((1, 2), p=(0.75, 0.25)))):
        is_at_edge = bool(rng.random() < 0.35)
        if is_at_edge:
            x, y = part.edge_point(rng.uniform(0, 1), rng.integers(4))
        else:
            x, y = _face_point(rng, 4.0)
        found.append(
            Dent(
                x=x,
                y=y,
                radius=rng.uniform(7.0, 10.5) if is_at_edge else rng.uniform(5.5, 9.5),
                depth=rng.uniform(1.5, 2.8),
                stretch=rng.uniform(1.0, 1.5),
                angle=rng.uniform(0, np.pi),
                is_at_edge=is_at_edge,
            )
        )
    return tuple(found)
