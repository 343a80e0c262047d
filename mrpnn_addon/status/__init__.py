"""What panels say: forecasts, checks, and the last render and comparison of the open file."""
