"""What happens to the regions of a foam in the course of a run: they pop, merge, appear, and pop at walls."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.cluster import Event, Pop
from melp_warp.stepping.carriers import normal_part
from melp_warp.stepping.sampling import liquid
from melp_warp.stepping.topology import Stored, add_region, merge_regions, pop_region

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation
    from melp_warp.stages.state import Course

BORDER_COVER = 0.3
"""Where two regions merge, the film between them goes down to this cover, borders and all, so that the hole heals."""

WALL_REACH = 0.5
"""Height above a wall that pops bubbles at which one touches it, in E spacings."""

CLEARANCE = 1.0
"""Room that a bubble to be born needs around it, in E spacings."""


class Events:
    """The scripted and the caused changes of one run; what is still to come is in the state, see `Course`."""

    def __init__(self, simulation: Simulation):
        self._sim = simulation
        self.cluster = cluster = simulation.scene.shape
        self._scripted: list[Event] = sorted(cluster.events, key=lambda event: event.time)
        self._popping = [wall for wall in cluster.walls if wall.pops]

    def begin(self, course: Course) -> None:
        """Let all of it come."""
        late = [k for k, b in enumerate(self.cluster.bubbles) if b.born > 0.0]
        course.pending = len(self._scripted)
        course.unborn = sorted(late, key=lambda k: self.cluster.bubbles[k].born)

    def pending(self, course: Course) -> list[Event]:
        """Scripted events to come, in order of time."""
        return self._scripted[len(self._scripted) - course.pending :]

    def following(self) -> float | None:
        """Time of the next change that is not due yet, s; None for none."""
        course, time = self._sim.state.course, self._sim.time
        times = [event.time for event in self.pending(course)[:1]]
        times += [self.cluster.bubbles[k].born for k in course.unborn if self.cluster.bubbles[k].born > time][:1]
        later = [t for t in times if t > time + 1e-12]
        return min(later, default=None)

    def due(self) -> Callable[[Stored], None] | None:
        """The change to carry out now, None for none.

        One at a time: what a film is shared with is to be found anew before the next.
        """
        simulation = self._sim
        time = simulation.time + 1e-12
        course = simulation.state.course
        while (pending := self.pending(course)) and pending[0].time <= time:
            course.pending -= 1
            change = self._carry_out(pending[0])
            if change is not None:
                return change
        if not self._popping and not course.unborn:
            return None
        x = simulation.state.e.x.numpy() + simulation.state.origin
        return self._at_walls(x) or self._birth(x, time)

    def _carry_out(self, event: Event) -> Callable[[Stored], None] | None:
        """What an event changes; None, with a notice, where there is nothing to change."""
        labels = self._sim.film.labels
        missing = [region for region in event.regions if region not in labels]
        if missing:
            return self._miss(event, f"there is no region {missing[0]}")
        indices = [labels.index(region) for region in event.regions]
        if isinstance(event, Pop):
            hole = None if event.delete else self._sim.burst.pop(event, indices[0])
            return hole or self._pop(indices[0])
        partition = find_partition(self._sim, *indices)
        if not partition["e"].any():
            return self._miss(event, "they share no film")
        hole = None if event.delete else self._sim.burst.merge(event, *indices)
        return hole or self._merge(*indices, partition)

    def _miss(self, event: Event, why: str) -> None:
        """Note that an event changes nothing."""
        simulation = self._sim
        what = f"{type(event).__name__} of {' and '.join(map(str, event.regions))} at {event.time:g} s"
        coming = [region for region in event.regions if region in simulation.state.course.unborn]
        more = f": bubble {coming[0]} is still to come" if coming else ""
        simulation.notices.note("event without effect", 1.0, f"{what} changes nothing, as {why}{more}")

    def _pop(self, k: int) -> Callable[[Stored], None]:
        partners = self._sim.stepper.membrane.find_partners("l") if self._sim.has_l else None
        burst = self._sim.burst

        def change(stored: Stored) -> None:
            if burst is not None:
                burst.release(stored, k)
            pop_region(stored, k, partners)

        return change

    def _merge(self, k: int, other: int, partition: dict[str, np.ndarray]) -> Callable[[Stored], None]:
        burst = self._sim.burst

        def change(stored: Stored) -> None:
            if burst is not None:
                burst.release_between(stored, k, other, partition)
            merge_regions(stored, k, other, partition)

        return change

    def _at_walls(self, x: np.ndarray) -> Callable[[Stored], None] | None:
        for wall in self._popping:
            height = (x - np.array(wall.point)) @ np.array(wall.normal)
            near = np.flatnonzero(height < WALL_REACH * self._sim.film.spacing)
            if len(near):
                return self._pop(int(self._sim.state.e.region.numpy()[near].min()))
        return None

    def _birth(self, x: np.ndarray, time: float) -> Callable[[Stored], None] | None:
        """The first bubble whose time has come and whose place is free."""
        simulation = self._sim
        unborn = simulation.state.course.unborn
        for label in unborn:
            bubble = self.cluster.bubbles[label]
            if bubble.born > time:
                return None
            room = np.linalg.norm(x - np.array(bubble.centre), axis=1)
            if room.min(initial=np.inf) > bubble.radius + CLEARANCE * simulation.film.spacing:
                unborn.remove(label)
                particles, gauge = self._new_bubble(label)
                return lambda stored: add_region(stored, label, particles, gauge, bubble.velocity)
        return None

    def _new_bubble(self, label: int) -> tuple[dict, float]:
        simulation = self._sim
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
                    "u": velocity if scene.l_per_e else normal_part(velocity, s.normals),
                    "v": velocity,
                    "mass": mass,
                    "surfactant": amount,
                    "eta": eta,
                    **{one.name: one.held(s.points, s.area, mass) for one in scene.carried if kind == "l"},
                }
        sigma = bubble.tension * scene.material.tension - scene.material.rt * scene.material.surfactant
        return particles, 4.0 * sigma / bubble.radius


def find_partition(simulation: Simulation, k: int, other: int) -> dict[str, np.ndarray]:
    """Mask of the particles of regions k and `other` on the film between them."""
    membrane, state = simulation.stepper.membrane, simulation.state
    mask = {}
    for kind in "el" if simulation.has_l else "e":
        partner = membrane.find_partners(kind)
        region = (state.e if kind == "e" else state.l).region.numpy()
        mask[kind] = ((region == k) & (partner == other)) | ((region == other) & (partner == k))
    cover, region = membrane.read_cover(), state.e.region.numpy()
    nearest = membrane.nearest_regions()
    between = ((region == k) & (nearest == other)) | ((region == other) & (nearest == k))
    mask["e"] |= between & (cover > BORDER_COVER)
    return mask
