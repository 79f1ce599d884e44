"""What L carry besides liquid and surfactant (docs/carried.md): a second pass of what these go through."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.device.launch import copy
from melp_warp.kernels import carried as kq
from melp_warp.stages.film import Film
from melp_warp.stages.state import State
from melp_warp.stages.transfer import Transfer


class Carriage:
    """Quantities that a scene declares. Made only where it declares some.

    Attributes:
        of_e: name -> [n_e] how much the L near each E hold, as `gather` found it last.
        u, mass, eta: [n_l] what a second pass may write over.
    """

    needs = ("transfer",)
    kernels = ("carried", "circulation")

    def __init__(self, film: Film, state: State, transfer: Transfer):
        self.film, self.state, self.transfer = film, state, transfer
        self.of_e = {one.name: film.zeros(film.n_e) for one in state.declared}
        self.u, self.mass, self.eta = film.zeros(film.n_l, wp.vec3), film.zeros(film.n_l), film.zeros(film.n_l)
        self._mass_e = film.zeros(film.n_e)

    def gather(self, name: str) -> wp.array:
        """`of_e` of a quantity; follows `Transfer.normalize`, whose weights it takes."""
        return self._gather(self.state.carried[name], self.of_e[name])

    def gather_mass(self) -> wp.array:
        """[n_e] liquid of the L near each E, by the same weights, kg: what a mean is over."""
        return self._gather(self.state.l.mass, self._mass_e)

    def _gather(self, held: wp.array, found: wp.array) -> wp.array:
        self.transfer.gather_amount(held, found)
        return found

    def give(self, name: str, change: wp.array) -> None:
        """Give L what E gain of a quantity, `change` [n_e], each by the area that it claims."""
        self.transfer.give_made(change, self.state.carried[name])

    def spare(self) -> None:
        """Copy what a second pass writes over."""
        lag = self.state.l
        for copied, own in ((self.u, lag.u), (self.mass, lag.mass), (self.eta, lag.eta)):
            copy(copied, own)

    def collect(self) -> None:
        """Let the rim keep what L held whose liquid it has collected."""
        held = self.state.carried
        for name in self.of_e:
            self.film.launch_l(kq.collect_amount_l, [self.state.l.mass], [held[name], held[f"{name}_rim"]])

    def total(self, name: str) -> float:
        """All there is of a quantity, with what the rim has collected and free rims and drops hold (reads back)."""
        state = self.state
        held = state.carried[name].numpy()
        if state.l.behind is not None:
            held = held[state.l.behind.numpy() == 0]  # a free rim has it
        others = [state.carried.get(f"{name}_rim"), *(block.more[name] for block in (state.f, state.d) if block)]
        return float(sum(a.sum(dtype=np.float64) for a in (held, *(one.numpy() for one in others if one is not None))))
