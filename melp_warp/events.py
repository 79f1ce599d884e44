"""What happens to the regions of a foam in the course of a run: they pop, merge, appear, and pop at walls."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.cluster import Cluster, Event, Pop
from melp_warp.sampling import liquid
from melp_warp.surgery import Stored, add_region, merge_regions, pop_region

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation

BORDER_COVER = 0.3
"""Where two regions merge, the film between them goes down to this cover, borders and all, so that the hole heals."""

WALL_REACH = 0.5
"""Height above a wall that pops bubbles at which one touches it, in E spacings."""

CLEARANCE = 1.0
"""Room that a bubble to be born needs around it, in E spacings."""


class Events:
    """The scripted and the caused changes of one run.

    Attributes:
        pending: events to come, in order of time.
        unborn: numbers of the bubbles to come, in order of time.
    """

    def __init__(self, cluster: Cluster):
        self.cluster = cluster
        self.pending: list[Event] = sorted(cluster.events, key=lambda event: event.time)
        late = [k for k, b in enumerate(cluster.bubbles) if b.born > 0.0]
        self.unborn = sorted(late, key=lambda k: cluster.bubbles[k].born)
        self._popping = [wall for wall in cluster.walls if wall.pops]

    def skip(self, time: float, unborn: list[int]) -> None:
        """Forget what happened up to `time` (s), with these bubbles still to come."""
        self.pending = [event for event in self.pending if event.time > time + 1e-12]
        self.unborn = list(unborn)

    def mark(self) -> tuple[list[Event], list[int]]:
        """What is to come, to go `back` to."""
        return list(self.pending), list(self.unborn)

    def back(self, mark: tuple[list[Event], list[int]]) -> None:
        """Let come again what was to come when `mark` was taken."""
        self.pending, self.unborn = (list(one) for one in mark)

    def following(self, time: float) -> float | None:
        """Time of the next change that is not due yet, s; None for none."""
        times = [event.time for event in self.pending[:1]]
        times += [self.cluster.bubbles[k].born for k in self.unborn if self.cluster.bubbles[k].born > time][:1]
        later = [t for t in times if t > time + 1e-12]
        return min(later, default=None)

    def due(self, simulation: Simulation) -> Callable[[Stored], None] | None:
        """The change to carry out now, None for none.

        One at a time: what a film is shared with is to be found anew before the next.
        """
        time = simulation.time + 1e-12
        while self.pending and self.pending[0].time <= time:
            change = self._scripted(self.pending.pop(0), simulation)
            if change is not None:
                return change
        if not self._popping and not self.unborn:
            return None
        x = simulation.state.e.x.numpy() + simulation.state.origin
        return self._at_walls(x, simulation) or self._birth(x, time, simulation)

    def _scripted(self, event: Event, simulation: Simulation) -> Callable[[Stored], None] | None:
        """What an event changes; None, with a notice, where there is nothing to change."""
        labels = simulation.film.labels
        missing = [region for region in event.regions if region not in labels]
        if missing:
            return self._miss(event, f"there is no region {missing[0]}", simulation)
        indices = [labels.index(region) for region in event.regions]
        if isinstance(event, Pop):
            return self._pop(indices[0], simulation)
        partition = self._partition(simulation, *indices)
        if not partition["e"].any():
            return self._miss(event, "they share no film", simulation)
        return lambda stored: merge_regions(stored, *indices, partition)

    def _miss(self, event: Event, why: str, simulation: Simulation) -> None:
        """Note that an event changes nothing."""
        what = f"{type(event).__name__} of {' and '.join(map(str, event.regions))} at {event.time:g} s"
        coming = [region for region in event.regions if region in self.unborn]
        more = f": bubble {coming[0]} is still to come" if coming else ""
        simulation.notices.note("event without effect", 1.0, f"{what} changes nothing, as {why}{more}")

    def _pop(self, k: int, simulation: Simulation) -> Callable[[Stored], None]:
        partners = simulation.stepper.membrane.find_partners("l") if simulation.has_l else None
        return lambda stored: pop_region(stored, k, partners)

    def _at_walls(self, x: np.ndarray, simulation: Simulation) -> Callable[[Stored], None] | None:
        for wall in self._popping:
            height = (x - np.array(wall.point)) @ np.array(wall.normal)
            near = np.flatnonzero(height < WALL_REACH * simulation.film.spacing)
            if len(near):
                return self._pop(int(simulation.state.e.region.numpy()[near].min()), simulation)
        return None

    def _birth(self, x: np.ndarray, time: float, simulation: Simulation) -> Callable[[Stored], None] | None:
        """The first bubble whose time has come and whose place is free."""
        for label in self.unborn:
            bubble = self.cluster.bubbles[label]
            if bubble.born > time:
                return None
            room = np.linalg.norm(x - np.array(bubble.centre), axis=1)
            if room.min(initial=np.inf) > bubble.radius + CLEARANCE * simulation.film.spacing:
                self.unborn.remove(label)
                particles, gauge = self._new_bubble(label, simulation)
                return lambda stored: add_region(stored, label, particles, gauge)
        return None

    @staticmethod
    def _partition(simulation: Simulation, k: int, other: int) -> dict[str, np.ndarray]:
        """Mask of the particles of regions k and `other` on the film between them."""
        membrane, state = simulation.stepper.membrane, simulation.state
        mask = {}
        for kind in "el" if simulation.has_l else "e":
            partner = membrane.find_partners(kind)
            region = (state.e if kind == "e" else state.l).region.numpy()
            mask[kind] = ((region == k) & (partner == other)) | ((region == other) & (partner == k))
        cover, region = membrane.cover.numpy(), state.e.region.numpy()
        nearest = membrane.nearest_regions()
        between = ((region == k) & (nearest == other)) | ((region == other) & (nearest == k))
        mask["e"] |= between & (cover > BORDER_COVER)
        return mask

    def _new_bubble(self, label: int, simulation: Simulation) -> tuple[dict, float]:
        scene, film, bubble = simulation.scene, simulation.film, self.cluster.bubbles[label]
        particles = {}
        for kind, count, offset in (("e", 1, 0.0), ("l", scene.l_per_e, 0.5)):
            if count:
                s = self.cluster.sample_bubble(label, film.spacing**2 / count, offset)
                eta, mass, amount = liquid(scene, s.points, s.area, np.full(len(s.points), label))
                velocity = np.broadcast_to(np.array(bubble.velocity), s.points.shape)
                particles[kind] = {
                    "x": s.points - simulation.state.origin,
                    "normal": s.normals,
                    "u": velocity,
                    "v": velocity,
                    "mass": mass,
                    "surfactant": amount,
                    "eta": eta,
                }
        sigma = bubble.tension * scene.material.tension - scene.material.rt * scene.material.surfactant
        return particles, 4.0 * sigma / bubble.radius
