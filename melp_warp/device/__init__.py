"""How kernels are run: launches and graphs, linear solvers, numbers on the device, precision, the process."""
