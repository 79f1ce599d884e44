"""One time step, as a table of contents."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import warp as wp

from melp_warp.advance import EulerianAdvance, LagrangianAdvance, Redistribution
from melp_warp.errors import SimulationError
from melp_warp.film import Film
from melp_warp.foam import Exchange, FoamMembrane
from melp_warp.forces import Forces
from melp_warp.geometry import Geometry
from melp_warp.kernels import diagnostics as kd
from melp_warp.kernels import transfer as kt
from melp_warp.launch import launch
from melp_warp.membrane import Membrane
from melp_warp.neighbors import NeighborLists
from melp_warp.rim import Rim
from melp_warp.state import State
from melp_warp.surfactant import Fields, Tangential
from melp_warp.transfer import Transfer

STAGES = ("neighbors", "l_to_e", "geometry", "membrane", "surfactant", "e_to_l", "advance_e", "advance_l")


class Stepper:
    """Holds the stages that a film's features ask for and runs them in order.

    Attributes:
        wall: seconds spent in each stage since the last reset (launch time only on a GPU).
    """

    def __init__(self, film: Film, state: State):
        self.film, self.state = film, state
        f = film.features
        self.lists = NeighborLists(film, state)
        self.geometry = Geometry(film, state, self.lists)
        self.fields = Fields(film, state, self.geometry)
        self.forces = Forces(film, state)
        self.rim = Rim(film, state, self.lists, self.geometry) if f.rim else None
        self.transfer = Transfer(film, state, self.lists, self.geometry) if f.lagrangian else None
        self.membrane = self._make_membrane() if f.moving else None
        self.tangential = (
            Tangential(film, state, self.lists, self.geometry, self.fields, self.forces, self.rim)
            if f.lagrangian
            else None
        )
        self.e_advance = EulerianAdvance(film, state, self.lists, self.geometry) if f.moving else None
        shifted = f.moving and film.numerics.redistribution > 0.0
        self.redistribution = Redistribution(film, state, self.lists, self.geometry) if shifted else None
        self.l_advance = LagrangianAdvance(film, state, self.lists, self.geometry) if f.lagrangian else None
        self.exchange = Exchange(film, state, self.lists, self.fields) if f.exchanges else None
        self.broken = wp.array([0, 2**31 - 1], dtype=wp.int32, device=film.device)
        still = film.zeros(1, wp.vec3)
        self.start, self.frame = (self.membrane.start, self.membrane.frame) if f.moving else (still, still)
        # lists within a film move along with it; those between regions do not
        self.at_rest = film.zeros(film.regions, wp.vec3) if f.foam else self.frame
        self.wall = dict.fromkeys(STAGES, 0.0)
        self.steps = 0
        self.geometry.update()

    def _make_membrane(self) -> Membrane | FoamMembrane:
        common = [self.film, self.state, self.lists, self.geometry, self.fields, self.forces]
        return FoamMembrane(*common) if self.film.features.foam else Membrane(*common, self.rim)

    def step(self, dt: float) -> None:
        """Advance the film by dt (s)."""
        f, e = self.film.features, self.state.e
        with self._stage("neighbors"):
            if self.exchange is not None and self.exchange.due(dt):
                self.exchange.apply(dt)  # (27), (28)
                self.lists.rebuild_l()
            else:
                self.lists.update_l()
        with self._stage("l_to_e"):
            if f.lagrangian:
                self.transfer.l_to_e()  # (6), (7)
            else:
                self.film.launch_e(kt.keep_normal_e, [e.normal], [e.u])
            self.fields.update()
            self.forces.update()
        if f.moving:
            with self._stage("membrane"):
                self.membrane.solve(dt)  # (12), gas
        if f.lagrangian:
            with self._stage("surfactant"):
                self.tangential.solve(dt)  # (14), (15)
                if f.recoils:
                    self.membrane.recoil(self.tangential.traction, dt)
            with self._stage("e_to_l"):
                self.transfer.e_to_l(self.tangential.find_dilation(), dt)  # (16)-(18), (8)
                v = self.l_advance.find_velocity(e.x, self.start, dt)
        if f.moving:
            with self._stage("advance_e"):
                if not f.foam:
                    self.membrane.find_frame()
                self.e_advance.advance(self.membrane.u_mid, self.frame, dt)  # (19)
                if self.redistribution is not None:
                    self.redistribution.apply(dt)  # (20)
                if f.foam:
                    self.membrane.recall()
                if self.rim is not None:
                    self.rim.extend()
                self.lists.record_e(self.e_advance.x_old, self.at_rest, dt)
            with self._stage("geometry"):
                self.lists.update_e()
                self.geometry.update()  # (9), (10), (11)
                if f.closed:
                    self.membrane.close_volume()
        if f.lagrangian:
            with self._stage("advance_l"):
                self.l_advance.advance(v, self.frame, self.state.motion, dt)  # Algorithm 7
                self.lists.record_l(self.at_rest, dt)
        self.state.time += dt
        self.steps += 1

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self._guard(name)
        self.wall[name] += time.perf_counter() - began

    def _guard(self, name: str) -> None:
        """Note on the device the first stage that leaves a number that is not finite."""
        number = STAGES.index(name) + 1
        e, lagrangian = self.state.e, self.state.l
        if name in ("e_to_l", "advance_l"):
            launch(kd.find_broken, self.film.n_l, [lagrangian.x, lagrangian.v, number], [self.broken], self.film.device)
        elif name != "neighbors":
            self.film.launch_e(kd.find_broken, [e.x, e.u, number], [self.broken])

    def check(self) -> None:
        """Raise if a stage left a number that is not finite, a list overflowed or the gas collapsed (reads back).

        Raises:
            SimulationError: names the stage and the particle.
        """
        stage, particle = (int(v) for v in self.broken.numpy())
        if stage:
            name = STAGES[stage - 1]
            kind = "L" if name in ("e_to_l", "advance_l") else "E"
            raise SimulationError(f"stage {name}: {kind} particle {particle} is not finite")
        if self.film.features.closed:
            volume = self.state.gas.numpy()[:, 0]
            k = int(np.argmin(volume))
            if not np.all(volume > 0.0):
                raise SimulationError(f"stage membrane: the enclosed volume is {volume[k]:.3g} m^3, region {k}")
        self.lists.check()
        if self.film.features.foam:
            self.membrane.check()
