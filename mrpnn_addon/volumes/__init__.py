"""Volume objects, closed meshes and fluid domains as density grids."""
