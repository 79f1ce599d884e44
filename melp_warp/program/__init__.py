"""The program around a simulation: runs and their folders, estimates, reports, Blender."""
