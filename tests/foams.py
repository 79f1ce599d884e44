"""Exact foams as particles: double bubbles, and two, three or four equal bubbles, with what a solver does to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from melp_warp.frame import ParticleFrame
from melp_warp.shapes import fibonacci_sphere

DENSE = 400
"""Points along a circle of a line: fine enough to be the line."""


@dataclass
class Patch:
    """Evenly spread points of one film of one region: [n, 3] m, outward normals [n, 3], area of each, m^2.

    A `shared` film lies between two regions.
    """

    points: np.ndarray
    normals: np.ndarray
    area: float
    region: int
    shared: bool


def frame_of(points, normals, area, region) -> ParticleFrame:
    n = len(points)
    return ParticleFrame(
        points=points.astype(np.float32),
        velocities=np.zeros((n, 3), np.float32),
        ids=np.arange(n),
        widths=np.sqrt(4.0 / np.pi * area).astype(np.float32),
        normals=normals.astype(np.float32),
        thickness=np.full(n, 500.0, np.float32),
        region=region.astype(np.int32),
        black_film=np.zeros(n, np.int32),
    )


def solved(patches, lines, spacing, jitter=0.1, noise=0.02, gap=0.02, rounding=1.5, seed=1) -> ParticleFrame:
    """The patches as a solver would leave them; all lengths in spacings.

    Args:
        patches: the films.
        lines: [m, 3] dense points on all lines, m.
        spacing: m.
        jitter: largest random move along the film.
        noise: standard deviation of a random move along the normal.
        gap: between the two sides of a partition, by which either side is moved inwards by half.
        rounding: distance from a line at which an arc in a corner of 120 degrees starts.
        seed: of what is random.
    """
    rng = np.random.default_rng(seed)
    points = np.concatenate([p.points for p in patches])
    normals = np.concatenate([p.normals for p in patches])
    area = np.concatenate([np.full(len(p.points), p.area) for p in patches])
    region = np.concatenate([np.full(len(p.points), p.region) for p in patches])
    nearest = np.concatenate([lines[np.argmin(((c[:, None] - lines) ** 2).sum(-1), axis=1)] for c in chunks(points)])
    toward = nearest - points
    distance = np.linalg.norm(toward, axis=1)
    toward -= np.sum(toward * normals, axis=1, keepdims=True) * normals
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    move = rng.uniform(-jitter, jitter, points.shape)
    move -= np.sum(move * normals, axis=1, keepdims=True) * normals
    turn, aside, inward, stretch = rounded(distance / spacing, rounding)
    shared = np.concatenate([np.full(len(p.points), p.shared) for p in patches])
    inward = inward + np.where(shared, 0.5 * gap, 0.0) + noise * rng.standard_normal(len(points))
    moved = points + spacing * (move + aside[:, None] * toward - inward[:, None] * normals)
    turned = np.cos(turn)[:, None] * normals + np.sin(turn)[:, None] * toward
    return frame_of(moved, turned, stretch * area, region)


def rounded(distance, start):
    """How an arc that starts at `start` from a line of 120 degrees moves the points of a film at `distance` from it.

    Returns:
        Turn of the normal towards the line (radians), moves towards the line and inwards, and factor on the area.
    """
    if not start:
        return np.zeros(len(distance)), np.zeros(len(distance)), np.zeros(len(distance)), 1.0
    radius, most = start * np.sqrt(3.0), np.pi / 6.0
    share = np.maximum(1.0 - distance / start, 0.0)
    turn = most * share
    aside = radius * np.sin(turn) - start * share
    return turn, aside, radius * (1.0 - np.cos(turn)), np.where(share > 0.0, radius * most / start, 1.0)


def chunks(points, size=500):
    return [points[at : at + size] for at in range(0, len(points), size)]


def sphere_patch(center, radius, spacing, keep, region, inward=None, turn=0.0) -> Patch:
    """The part of an evenly sampled sphere where `keep(points)`; `inward` says the side of a shared film's normals."""
    n = round(4.0 * np.pi * radius**2 / spacing**2)
    normals = fibonacci_sphere(n, turn)
    points = center + radius * normals
    chosen = keep(points)
    return Patch(
        points[chosen],
        (-1.0 if inward else 1.0) * normals[chosen],
        4.0 * np.pi * radius**2 / n,
        region,
        inward is not None,
    )


def disc_patch(center, normal, radius, spacing, keep, region) -> Patch:
    """The part of an evenly sampled disc where `keep(points)`."""
    n = round(np.pi * radius**2 / spacing**2)
    k = np.arange(n)
    r, angle = radius * np.sqrt((k + 0.5) / n), k * np.pi * (3.0 - np.sqrt(5.0))
    u, v = np.linalg.svd(normal[None])[2][1:]
    points = center + (r * np.cos(angle))[:, None] * u + (r * np.sin(angle))[:, None] * v
    chosen = keep(points)
    return Patch(points[chosen], np.broadcast_to(normal, points.shape)[chosen], np.pi * radius**2 / n, region, True)


def circle(center, normal, radius) -> np.ndarray:
    u, v = np.linalg.svd(normal[None])[2][1:]
    angle = np.linspace(0.0, 2.0 * np.pi, DENSE, endpoint=False)[:, None]
    return center + radius * (np.cos(angle) * u + np.sin(angle) * v)


def single(radius, count, **options) -> ParticleFrame:
    """One bubble; no line is anywhere near."""
    spacing = radius * np.sqrt(4.0 * np.pi / count)
    ball = sphere_patch(np.zeros(3), radius, spacing, lambda x: np.ones(len(x), bool), 0)
    return solved([ball], np.full((1, 3), 1e3), spacing, **options)


@dataclass
class Double:
    """Two spheres of radii `first` >= `second` along x, partition of curvature 1/second - 1/first.

    Attributes:
        first, second: radii, m.
        outside: dihedral angle outside, degrees; 120 in equilibrium.
    """

    first: float = 1.0
    second: float = 1.0
    outside: float = 120.0

    def __post_init__(self):
        turn = np.radians(180.0 - self.outside)
        self.apart = np.sqrt(self.first**2 + self.second**2 - 2.0 * self.first * self.second * np.cos(turn))
        self.cut = (self.apart**2 + self.first**2 - self.second**2) / (2.0 * self.apart)
        self.contact = np.sqrt(self.first**2 - self.cut**2)
        self.curvature = 1.0 / self.second - 1.0 / self.first

    def height(self):
        """How far the partition bulges into the first bubble, m."""
        k, c = self.curvature, self.contact
        return k * c**2 / (1.0 + np.sqrt(1.0 - (k * c) ** 2))

    def caps(self):
        """Heights of the two outer caps and of the partition's bulge, m."""
        return self.first + self.cut, self.second + self.apart - self.cut, self.height()

    def volumes(self):
        """Of the two bubbles, m^3."""
        one, two, bulge = (np.pi * h * (3.0 * self.contact**2 + h**2) / 6.0 for h in self.caps())
        return one - bulge, two + bulge

    def partition_area(self):
        """Area of the partition, m^2."""
        return np.pi * (self.contact**2 + self.height() ** 2)

    def areas(self):
        """Of the surface of the two bubbles, m^2."""
        one, two, _ = self.caps()
        return tuple(2.0 * np.pi * r * h + self.partition_area() for r, h in ((self.first, one), (self.second, two)))

    def frame(self, count, **options) -> ParticleFrame:
        """About `count` points on the first bubble."""
        x = np.array([1.0, 0.0, 0.0])
        spacing = np.sqrt(self.areas()[0] / count)
        patches = [
            sphere_patch(np.zeros(3), self.first, spacing, lambda p: p[:, 0] < self.cut, 0),
            sphere_patch(self.apart * x, self.second, spacing, lambda p: p[:, 0] > self.cut, 1, turn=0.3),
        ]
        for region, sign in ((0, 1.0), (1, -1.0)):
            patches.append(self.side(spacing, region, sign))
        return solved(patches, circle(self.cut * x, x, self.contact), spacing, **options)

    def side(self, spacing, region, sign):
        """One side of the partition; `sign` 1 has its normal along x."""
        x = np.array([1.0, 0.0, 0.0])
        if abs(self.curvature) < 1e-9:
            return disc_patch(self.cut * x, sign * x, self.contact, spacing, lambda p: np.ones(len(p), bool), region)
        radius = 1.0 / self.curvature
        center = (self.cut - self.height() + radius) * x  # on the side of the second bubble
        keep = lambda p: p[:, 0] < self.cut  # noqa: E731
        return sphere_patch(center, radius, spacing, keep, region, inward=sign > 0.0, turn=0.5 * region)


def cluster(n, count, **options) -> ParticleFrame:
    """Two, three or four equal bubbles of radius 1, each touching each: spheres whose centres are 1 apart."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8.0)
    centers = corners[:n] - corners[:n].mean(axis=0)
    spacing = np.sqrt(4.0 * np.pi / count)
    pairs = [(k, s) for k in range(n) for s in range(n) if k != s]

    def within(*regions):
        def keep(x):
            product = x @ centers.T
            return product[:, list(regions)].min(axis=1) >= product.max(axis=1) - 1e-9

        return keep

    patches = [sphere_patch(centers[k], 1.0, spacing, within(k), k, turn=0.2 * k) for k in range(n)]
    lines = [np.zeros((0, 3))]
    for k, s in pairs:
        middle, normal = 0.5 * (centers[k] + centers[s]), centers[s] - centers[k]
        patches.append(disc_patch(middle, normal, np.sqrt(0.75), spacing, within(k, s), k))
        ring = circle(middle, normal, np.sqrt(0.75))
        lines.append(ring[within(k, s)(ring)])
    for k in range(n):
        for s in range(k):
            for t in range(s):
                lines.append(inner_line(centers[[k, s, t]], within(k, s, t)))
    return solved(patches, np.concatenate(lines), spacing, **options)


def inner_line(centers, keep) -> np.ndarray:
    """Points at equal distance of three centres, from within the three spheres and the cell."""
    middle = centers.mean(axis=0)
    axis = np.cross(centers[1] - centers[0], centers[2] - centers[0])
    points = middle + np.linspace(-1.0, 1.0, 4 * DENSE)[:, None] * axis / np.linalg.norm(axis)
    return points[(np.linalg.norm(points - centers[0], axis=1) <= 1.0) & keep(points)]
