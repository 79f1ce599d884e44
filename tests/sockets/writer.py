"""A socket's example: a writer of the E as text, a file a frame."""

import numpy as np


class Text:
    """Positions and velocities, m and m/s."""

    def open(self, folder, plan, simulation, there):
        """Remove what is later than the run goes on from."""
        self.folder = folder
        for path in folder.glob("*.txt"):
            if there is None or int(path.stem) > there[1]:
                path.unlink()

    def write(self, moment):
        """Write a frame."""
        frame = moment.particles("e")
        np.savetxt(self.folder / f"{moment.number:06d}.txt", np.hstack([frame.points, frame.velocities]))

    def close(self):
        """Nothing is left to do."""
