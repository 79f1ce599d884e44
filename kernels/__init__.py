"""Device code: Warp functions and kernels, one file a stage."""
