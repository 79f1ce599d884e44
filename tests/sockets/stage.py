"""A socket's example: a stage that sums up how long each E has been falling."""

import warp as wp

from melp_warp import Sphere, Stage, declare

PARAMETERS = declare(radius=0.03, gravity=9.81, e_count=150, l_per_e=2, frames=2)


@wp.kernel(enable_backward=False)
def count_fall_e(u: wp.array(dtype=wp.vec3), dt: wp.array(dtype=float), fallen: wp.array(dtype=float)):
    """Add dt where an E moves down. [n_e], s."""
    i = wp.tid()
    fallen[i] = fallen[i] + wp.where(u[i][1] < 0.0, dt[0], 0.0)


class Fall(Stage):
    """Remembers a time for each E, and tells the longest."""

    name, after, remembers = "fall", "e_to_l", {"time": (wp.float32, "e")}

    def run(self):
        """Launch its kernel."""
        self.film.launch_e(count_fall_e, [self.state.e.u, self.stepper.dt.array], [self.remembered("time")])

    def report(self):
        """What the log says."""
        return {"longest": float(self.remembered("time").numpy().max())}


def build(p):
    """Build the scene."""
    return p.scene("stage", Sphere(p.radius), stages=[Fall])
