"""What a frame shows, by NumPy alone: angles, radii, pressures, areas, volumes, grain."""

from melp_warp.measure.results import Measurement, measure, measure_cache

__all__ = ["Measurement", "measure", "measure_cache"]
