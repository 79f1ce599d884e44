"""Stage 3 on the host, body forces: gravity, and the forces that a scene brings along (docs/add-a-force.md)."""

from __future__ import annotations

import hashlib
import linecache
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import warp as wp

from melp_warp.device.launch import CPU_BLOCK
from melp_warp.device.scalars import Setting
from melp_warp.errors import InputError, in_a_line, require
from melp_warp.kernels import forces as kf
from melp_warp.keyframes import value_at
from melp_warp.scene_force import SIGNATURE, Force
from melp_warp.stages.film import Film
from melp_warp.stages.state import State

if TYPE_CHECKING:
    from melp_warp.stages.free_rim import TornFilm
    from melp_warp.stages.geometry import Geometry
    from melp_warp.stages.surfactant import Fields

_KERNEL = """
@wp.kernel(enable_backward=False, module=module)
def {name}(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    origin: wp.array(dtype=wp.vec3),
    time: wp.array(dtype=float),
    gravity: wp.array(dtype=wp.vec3),
{declared}    dt: wp.array(dtype=float),
    body: wp.array(dtype=wp.vec3),
    still: wp.array(dtype=wp.vec3),
    rate: wp.array(dtype=float),
    hold: wp.array(dtype=float),
    before: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    total = gravity[0]
    slower = float(0.0)
    at = x[i] + origin[0]
    v = u[i]
{called}    body[i] = total
    still[i] = total + slower * v
    rate[i] = slower
    hold[i] = hold_of(slower, dt[0])
    before[i] = v
"""

_CALL = """    a_{k}, r_{k} = force_{k}(at, time[0], v, eta[i]{given})
    total += a_{k}
    slower += wp.max(r_{k}, 0.0)
"""


_made: dict[str, wp.Kernel] = {}


def fuse(forces: Sequence[Force]) -> wp.Kernel:
    """One kernel for all forces of a scene, named by what they are: graphs tell kernels apart by their names.

    Its arguments are fields of E; where positions are measured from, time, gravity, the forces' numbers and the step,
    [1] each; and what it finds, see `Forces`: `body`, `still`, `rate`, `hold` and the velocity that they are of.
    """
    told = "".join(force.digest for force in forces)
    name = f"push_by_scene_{hashlib.sha256(told.encode()).hexdigest()[:12]}_e"
    if name in _made:
        return _made[name]
    declared = called = ""
    for k, force in enumerate(forces):
        names = [f"{key}_{k}" for key in force.numbers]
        declared += "".join(f"    {number}: wp.array(dtype=float),\n" for number in names)
        called += _CALL.format(k=k, given="".join(f", {number}[0]" for number in names))
    text = _KERNEL.format(name=name, declared=declared, called=called)
    if wp.vec3 is wp.vec3d:
        from melp_warp.device.float64 import rewrite

        text = rewrite(text)
    path = f"<{name}>"
    linecache.cache[path] = (len(text), None, text.splitlines(keepends=True), path)
    functions = {f"force_{k}": force.function for k, force in enumerate(forces)}
    space = {"wp": wp, "__name__": name, "module": wp.get_module(name), "hold_of": kf.hold_of, **functions}
    exec(compile(text, path, "exec"), space)
    return _made.setdefault(name, space[name])


class Forces:
    """Acceleration that forces from outside give each E, and what it meets.

    The normal and the tangential dynamics both take it from here. Gravity is a number of the scene, not one of its
    forces: rims and drops feel it as well, and the budget stores it as height.

    Attributes:
        body: [n_e] m/s^2: at the start of a step, once it is settled the mean of the step.
        gravity: [1] m/s^2, in the middle of the step.
        still: [n_e] what it would be at rest, m/s^2.
        rate: [n_e] by which it falls as the velocity grows, 1/s; None without forces of the scene.
        hold: [n_e] see `kernels.forces.hold_of`; likewise.
        inertia: [n_e] what resists a change of velocity, kg: the mass of E, times `hold`.
        heavy: [n_e] the same with what hangs on E besides, kg.
        ease: [n_e] what fluxes of (14) count times, as velocities change less; None where it is 1.
    """

    needs = ("fields", "geometry", "edge")
    kernels = ("forces",)

    def __init__(self, film: Film, state: State, fields: Fields, geometry: Geometry, edge: TornFilm | None):
        gain, hung = geometry.gain, edge.inertia if edge is not None else None
        self.film, self.state, self._fields, self._gain, self._hung = film, state, fields, gain, hung
        n, device, mass = film.n_e, film.device, state.e.mass
        self.body = film.zeros(n, wp.vec3)
        self._gravity = Setting(device, wp.vec3)
        self.gravity = self._gravity.array
        self.still, self.rate, self.hold, self.ease = self.body, None, None, gain
        self.inertia, self.heavy = mass, mass if hung is None else hung
        if film.forces:
            self.rate, self.hold, self.inertia, self.ease = (film.zeros(n) for _ in range(4))
            self.heavy = self.inertia if hung is None else film.zeros(n)
            self.still, self._before = film.zeros(n, wp.vec3), film.zeros(n, wp.vec3)
            self._time, self._dt, self._origin = Setting(device), Setting(device), Setting(device, wp.vec3)
            self._numbers = [(force, key, Setting(device)) for force in film.forces for key in force.numbers]
            self._kernel = self._load()
        self.prepare(0.0)

    def _load(self) -> wp.Kernel:
        """The kernel of the scene's forces, compiled.

        Raises:
            InputError: one of them is no code that Warp takes.
        """
        kernel, device = fuse(self.film.forces), self.film.device
        try:
            kernel.module.load(device, CPU_BLOCK if device.is_cpu else 256)
        except Exception as error:
            names = ", ".join(force.name for force in self.film.forces)
            raise InputError(f"force {names} must be {SIGNATURE}, as Warp compiles it: {in_a_line(error)}") from error
        return kernel

    def prepare(self, dt: float) -> None:
        """Set what depends on time, for a step of dt (s): all is taken in its middle."""
        film, now = self.film, self.state.time + 0.5 * dt
        self._gravity.at(film.gravity_at(now))
        if film.forces:
            self._time.at(now)
            self._dt.at(dt)
            self._origin.at(tuple(self.state.origin.tolist()))
            for force, key, setting in self._numbers:
                number = value_at(force.numbers[key], now)
                require(math.isfinite(number), f"{key} of force {force.name} at {now:.4g} s", number, "a finite number")
                setting.at(number)

    def update(self) -> None:
        """Find the accelerations at the present positions and velocities."""
        film, e = self.film, self.state.e
        if not film.forces:
            film.launch_e(kf.set_gravity_e, [self.gravity], [self.body])
            return
        numbers = [setting.array for *_, setting in self._numbers]
        settings = [self._origin.array, self._time.array, self.gravity, *numbers, self._dt.array]
        film.launch_e(
            self._kernel,
            [e.x, e.u, self._fields.eta, *settings],
            [self.body, self.still, self.rate, self.hold, self._before],
        )
        heavy = self.heavy if self._hung is not None else None
        film.launch_e(kf.weigh_down_e, [e.mass, self.hold, self._hung, self._gain], [self.inertia, heavy, self.ease])

    def take_flow(self) -> None:
        """Along the film go on from the velocity as it is now."""
        if self.hold is not None:
            e = self.state.e
            self.film.launch_e(kf.take_flow_e, [e.u, e.normal, self.still, self.rate], [self.body, self._before])

    def note_braking(self, theta: wp.array, dt: wp.array, push: wp.array | None) -> None:
        """Add to `push` [n] (m/s) what forces change over the share theta of a step as the film is not at rest."""
        if self.hold is not None:
            self.film.launch_e(kf.note_braking_e, [self.body, self.still, theta, dt], [push])

    def settle(self, theta: wp.array, dt: wp.array) -> None:
        """Find the mean of the step's accelerations, once E have their velocity after the share theta [1] of it."""
        if self.hold is not None:
            self.film.launch_e(kf.settle_body_e, [self.state.e.u, self._before, self.hold, theta, dt], [self.body])
