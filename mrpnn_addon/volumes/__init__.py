"""Volume objects, closed meshes and fluid domains as grids of density."""
