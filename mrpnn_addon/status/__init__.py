"""What panels show: forecasts, checks, and the last render and comparison of the open file."""
