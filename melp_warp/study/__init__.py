"""Runs against theory, extremes and the trade of speed for accuracy; the tools and tests draw on them."""
