"""Scene scripts, one file a figure."""
