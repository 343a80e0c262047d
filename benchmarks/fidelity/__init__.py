"""Error against path-traced references, in the form of the tables of the paper."""
