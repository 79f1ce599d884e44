"""A socket's example: dust in the air around a bubble, which a stage lets sink at a speed of its own."""

import numpy as np
import warp as wp

from melp_warp import ParticleSet, Sphere, Stage, declare
from melp_warp.device.launch import launch

PARAMETERS = declare(radius=0.03, e_count=150, l_per_e=2, frames=2)


@wp.kernel(enable_backward=False)
def sink_dust(dt: wp.array(dtype=float), x: wp.array(dtype=wp.vec3), u: wp.array(dtype=wp.vec3)):
    """Move each particle with its velocity. [n], m."""
    i = wp.tid()
    x[i] = x[i] + dt[0] * u[i]


class Sink(Stage):
    """Moves the dust."""

    name, after = "sink", "advance_e"

    def run(self):
        """Launch its kernel."""
        dust = self.state.sets["Dust"]
        launch(sink_dust, len(dust["x"]), [self.stepper.dt.array], [dust["x"], dust["u"]], self.film.device)


def build(p):
    """Build the scene."""
    x = 0.1 * np.random.default_rng(1).normal(size=(40, 3))
    dust = ParticleSet("Dust", x, width=1e-3, arrays={"u": np.tile([0.0, -0.3, 0.0], (40, 1))})
    return p.scene("particle_set", Sphere(p.radius), stages=[Sink], sets=[dust])
