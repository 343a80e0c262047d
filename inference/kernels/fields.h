/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Data of the kernels that prepare what rays and networks read.

As in kernels.h. Arrays of three dimensions are in C order, unless their strides, in elements, are given. */

#ifndef MRPNN_FIELDS_H
#define MRPNN_FIELDS_H

#include "kernels.h"

/* Some slices of a grid, added to columns along a sun's rays: optical_depth_sweep.sweep. */
typedef struct {
    const float *density;        /* a grid, 0 outside */
    int64_t shape[3];            /* its slices, and the rows and columns of each */
    int64_t strides[3];
    int64_t count;               /* slices to add */
    const int64_t *slices;       /* (count), numbers */
    const int64_t *starts;       /* (count, 2), column at which the slice begins */
    const float *weights;        /* (count, 2, 4), of four neighbours */
    const float *fractions;      /* (count, 2), of a cell between columns and cells, or NULL: depths of columns */
    double half_step;
    float *columns;              /* (size[0], size[1]) */
    int64_t size[2];
    float *depths;               /* of cells: as the density; of columns: MORE more rows and columns */
    int64_t depth_strides[3];
    float *scratch;              /* (shape[1] + MORE, shape[2] + MORE) and (shape[2] + 2 MORE) */
} ColumnSweep;

/* A row of blocks of a sparse grid, added to columns along a sun's rays: SparseColumns. */
typedef struct {
    const float *values;         /* (rows, 8, 8, 8) */
    int64_t rows;
    int64_t strides[3];          /* of a block, main axis first */
    int64_t blocks;
    const int64_t *block_rows;   /* (blocks) in `values` */
    const int64_t *block_places; /* (blocks, 2), in blocks */
    const int64_t *slices;       /* (8), numbers within the blocks, in the order of visiting */
    const int64_t *starts;       /* (8, 2), column of block (0, 0) */
    const float *weights;        /* (8, 2, 4) */
    double half_step;
    float *columns;              /* (size[0], size[1]) */
    int64_t size[2];
    int64_t touched;
    const int64_t *tiles;        /* (touched, 2), tiles of 8 x 8 columns that are stored */
    float *depths;               /* (touched, 8, 8, 8) */
} BlockSweep;

/* Optical depths from points out of the working cube: OpenDepths. */
typedef struct {
    int64_t points;
    const float *positions;      /* (points, 3), in the cube from -1/2 to 1/2 */
    int64_t directions;
    const float *towards;        /* (directions, 3), unit vectors */
    int64_t samples;             /* of the density, in each direction */
    const float *middles;        /* (samples), distances */
    const float *lengths;        /* (samples), of the steps that they stand for */
    const int64_t *sampled;      /* (samples), numbers of levels */
    const float *levels[2];      /* densities */
    const int64_t *cells;        /* (levels), along an edge of the cube */
    const int64_t *strides;      /* (levels, 2), along the first two axes; that along the last is 1 */
    double reach;                /* distance from which on the lattice is read */
    const float *lattice;        /* (directions, edge, edge, edge), depths from cells, the outermost ones repeated */
    int64_t edge;
    float *depths;               /* (points, directions) */
} OpenDepthSamples;

/* Light that arrives at cells along a direction, for several sources and factors of extinction: light_ahead. */
typedef struct {
    int64_t shape[3];            /* cells along the axis that the direction follows most, and the others */
    int64_t strides[3];          /* of cells, in all of the following */
    int64_t cells;
    int64_t sign;                /* of the direction along the first of the axes */
    int64_t sources, scales;
    const float *extinction;     /* (cells) */
    const float *light;          /* (sources, cells) */
    const float *scale;          /* (scales), factors of extinction */
    double half_step;            /* length of half of a ray's way through a slice */
    int64_t row;                 /* a multiple of 8, at least shape[2] + 2 */
    const int64_t *starts;       /* (shape[0], 2), ray at which each slice begins, */
    const float *fractions;      /* (shape[0], 2), and how far its cells lie behind the rays */
    int64_t size[2];             /* of the plane of rays, at least the largest starts + (shape[1] + 1, row) */
    float *rays;                 /* (sources * scales + 1, size[0], size[1]), light, 0 at first, and transmittance, 1 */
    float *ahead;                /* (sources * scales + 1, cells), the same at the cells, filled */
    float *scratch;              /* (sources * (scales + 1) + 2, shape[1] + 2, row), 0 */
} LightAhead;

/* Light along the directions that leave one side of the cells: DiscreteOrdinates._follow_steps. */
typedef struct {
    int64_t cells;               /* n, along an edge */
    int64_t axis, sign;          /* that all directions share */
    int64_t directions;
    const int64_t *steps;        /* (directions, 2), along the other axes: -1, 0 or 1; 0 where the axis is 2 */
    const int64_t *kinds;        /* (directions), of `leaving` and `within` */
    const float *emit;           /* (directions, 5), weights of the field's parts in the source */
    const float *gather;         /* (directions, 4), weights of the radiance in fluence and flux, or NULL */
    const float *field;          /* (5, n, n, n), fluence, flux and beam */
    const float *beams;          /* (directions, n, n, n), of each direction instead of the field's; or NULL */
    const float *leaving;        /* (3, n, n, n), fraction of the source in the light that leaves a cell across a face,
                                    an edge and a corner */
    const float *within;         /* (3, n, n, n), and in the mean within it */
    const float *links;          /* (n, directions, n, n), slices first, fraction of the light that arrives; or NULL */
    const float *entering;       /* (directions), radiance at the faces of the cube, or NULL */
    float *sums;                 /* (4, n, n, n), fluence and flux, added to; without weights (directions, n, n, n),
                                    the mean radiance in each cell, filled */
    float *scratch;              /* (2, directions, n + 2, n + 2), at least (8, n) */
} OrdinateSweep;

/* What diffuses of light in cells, and limits: DiscreteOrdinates._correct. */
typedef struct {
    int64_t cells;               /* n, along an edge, at least 2 */
    const float *fluence;        /* (n, n, n), which the field lacks; or NULL */
    const float *diffusion;      /* (n, n, n), flux per gradient of this fluence */
    float *field;                /* (4, n, n, n), fluence and flux, changed */
    int64_t limited;             /* whether the fluence becomes at least 0 and the flux at most ... */
    double most_flux;            /* ... the fluence over this */
} LightCorrection;

/* Light along directions that rise most along one axis, and along the others: radiance_sweep.sweep_radiance. */
typedef struct {
    int64_t shape[3];            /* cells along the axis of the steepest rise, and the others */
    int64_t strides[2];          /* of the first two; neighbours along the last follow one another */
    int64_t signs[3];            /* 1, or -1 for axes along which light goes down */
    int64_t directions;
    const float *slopes;         /* (directions, 2) */
    const float *weights;        /* (directions, 4), of the radiance in fluence and in flux along each axis */
    const int64_t *kinds;        /* (directions), of the following arrays */
    const float *passed;         /* (kinds, cells), transmittance */
    const float *mean;           /* (kinds, cells), mean of exp(-tau) */
    const float *given;          /* (kinds, cells), radiance that the cell adds to the radiance that leaves it */
    const float *added;          /* (kinds, cells), and to its mean */
    int64_t cells;
    float *fluence;              /* (4, cells), fluence, and flux along the three axes, added to */
    float *scratch;              /* (2, directions, shape[1] + 2, shape[2] + 2) */
} RadianceSweep;

/* Moments of light that scatters once, along four directions that rise along every axis: wide_light.wide_light. */
typedef struct {
    int64_t shape[3];            /* cells along the axis of the steepest rise, and the others */
    int64_t strides[3];          /* negative for axes that are turned */
    int64_t first;               /* cell at which the directions enter */
    const uint8_t *kinds;        /* (cells), 0 where nothing is kept, 1 where the moments are, 2 where matter is, too */
    const float *slopes;         /* (2, 4), of the directions */
    const float *along;          /* (3, 4), unit vectors */
    const float *weights;        /* (4, 16), of the radiance in the moments */
    const float *passed;         /* (cells, 4), transmittance */
    const float *mean;           /* (cells, 4), mean of exp(-tau) */
    int64_t lobes;
    const float *light;          /* (cells, lobes, 5), amount, direction and row of the table */
    int64_t rows, columns;
    const float *table;          /* (rows, columns), phase function from a cosine of -1 to 1 */
    float *moments;              /* (cells, 16), added to */
    float *scratch;              /* (2, shape[1] + 1, shape[2] + 1, 4) */
} MomentSweep;

/* Photons of a lamp that scatter within the forward peak: peak_photons.peak_light. */
typedef struct {
    int64_t shape[3];
    const float *depth;          /* (cells), optical thickness of a cell's edge */
    const uint8_t *closed;       /* (3, cells), whether a surface parts a cell from the next along an axis; or NULL */
    double lamp[3];              /* in cells */
    double axis[3], cosine;      /* of the cone in which its light travels; -1 where there is none */
    int64_t photons;
    const int64_t *starts;       /* (photons), cells of the first collisions */
    const int64_t *numbers;      /* (photons), which tell their random numbers */
    int64_t collisions;          /* at most */
    double anisotropy, reduced;  /* G, and that of the wide angles */
    double wide;                 /* fraction of the scattering by wide angles */
    double albedo;
    float *sums;                 /* (cells, 5), fluence, flux and squares, added to */
} PeakPhotons;

/* Light paths from camera rays: light_paths.trace_paths. */
typedef struct {
    int64_t volumes, channels;
    const Medium *media;         /* (volumes), scattering of the channels where it varies */
    const Occupancy *majorants;  /* (volumes), their peaks alone */
    const double *anisotropies;  /* (volumes) */
    const double *albedos;       /* (volumes, channels), 1 where they vary */
    int64_t leaves;              /* of a binary tree of boxes, a power of two; */
    const double *boxes;         /* (2 leaves, 2, 3), lowest and highest corners of each: the root is number 1, and the parts
                                    of number n are 2 n and 2 n + 1; */
    const int64_t *contents;     /* (leaves), the volume in each, or -1 */
    int64_t rays;
    const double *origins, *directions;  /* (rays, 3) */
    const double *near_distance, *far_distance;  /* (rays), between which paths collide first */
    const int64_t *numbers;      /* (rays), which tell their random numbers */
    int64_t paths;               /* of each ray */
    int64_t collisions, steps;   /* of a path, at most */
    double negligible;           /* fraction of the light at which paths end */
    const volatile int32_t *stop;
    float *light;                /* (rays, paths, channels), fraction of the light that collisions keep */
    float *leaving;              /* (rays, paths, 3), directions in which paths left their last collisions */
    uint8_t *ends;               /* (rays, paths): 0 for no collision, 1 for paths that left, 2 for those given up */
} LightPaths;

/* Conjugate gradients: diffusion.solve. */
typedef struct {
    int64_t shape[3];
    const double *diagonal;      /* of the operator */
    const double *couplings;     /* (3, cells) */
    double *x, *residual, *direction, *product;
    double rz, limit;            /* the residual's norm, and the one at which to end */
    int64_t iterations;          /* at most, in this call */
} Diffusion;

/* Means of a grid's interpolant over cells of the working cube: working_cube.mean_density. */
typedef struct {
    Grid density;                /* dense: `shape` of `values` without padding; sparse: as for rays */
    int64_t low[3];              /* the first active voxel */
    int64_t voxels[3];           /* active voxels */
    int64_t cells;               /* along an edge of the cube */
    int64_t widths[3];           /* most voxels of a cell along each axis */
    const int64_t *firsts[3];    /* (cells), first voxel of a cell, from `low` */
    const float *weights[3];     /* (cells, width) */
    int64_t begin, end;          /* planes of cells to fill */
    float *out;
    int64_t strides[3];
    int64_t *held;               /* (widths[0]), the voxel plane that each of the planes below is made of, or -1 */
    float *scratch;              /* (widths[0], cells, cells), (voxels[1], voxels[2]) and (voxels[1], cells) */
} CellMeans;

/* Means of 2 x 2 x 2 cells: mip_lattices.density_pyramid. */
typedef struct {
    const float *fine;
    int64_t fine_strides[2];     /* along the first two axes; that along the last is 1 */
    float *coarse;
    int64_t coarse_strides[2];
    int64_t size[3];             /* coarse cells */
} Halving;

/* Cells half as large, interpolated between the centres of the large ones: halving.refined. */
typedef struct {
    const float *coarse;
    int64_t size[3];             /* of the coarse cells */
    float *fine;                 /* (2 size[0], 2 size[1], 2 size[2]), filled */
    float *scratch;              /* (size[1] + 1, size[2]) */
} Refining;

/* A grid interpolated between its cells' centres. */
typedef struct {
    const float *values;
    int64_t shape[3];
    const int32_t *below[3];     /* cell below each fine cell, along each axis */
    const float *fraction[3];    /* of the way to the next cell */
} Refinement;

/* Planes of a lattice that descriptors read: mip_lattices.fill_lattices. */
typedef struct {
    int64_t shape[3];            /* fine cells */
    Refinement density, depth, visibility;  /* density, or depth with or without visibility; others without values */
    double density_scale, density_step;
    double depth_scale, least_visible;
    uint16_t *packed;            /* (shape) */
    float *scratch;              /* (2, largest shape[2] of the grids) and (shape[2]) */
} LatticePart;

/* Values of a grid at the voxels of another: merge.resampled. */
typedef struct {
    Grid grid;
    Occupancy occupancy;
    int64_t power;               /* of the values */
    int64_t shape[3];            /* voxels to fill */
    double linear[9];            /* continuous indices of the grid from voxels */
    double offset[3];
    int64_t points;              /* per voxel */
    const double *places;        /* (points, 3), in indices */
    float *out;                  /* zeros, which stay where there are none of the grid's values */
    int64_t strides[3];
} Resampling;

/* Some planes of voxel centres that add to the columns around a lamp: LampOpticalDepth. */
typedef struct {
    Grid density;
    Pyramid pyramid;
    int64_t axis;                /* of the pyramid */
    double lamp[3];              /* in continuous indices */
    int64_t inside;              /* whether the density at the lamp adds to all columns first */
    int64_t planes;
    const int64_t *numbers;      /* (planes), index along the axis, in the order of distance */
    const int64_t *slices;       /* (planes), that each ends, or 0 */
    const double *ways;          /* (planes, 2), half the distances to the planes before and after */
    float *running;              /* (columns), depths so far */
    float *scratch;              /* (5 * columns of a row + voxels of a row + 6 + those of a plane) */
    int32_t *cells;              /* (columns of a row), scratch */
} LampSlices;

/* Optical depths from points towards a sun: SunOpticalDepth. */
typedef struct {
    Grid density;
    SunColumns columns;
    double sigma_t;
    int64_t outside;             /* whether points may lie outside the support */
    int64_t points;
    const float *index;          /* (3, points), continuous indices */
    float *out;                  /* (points) */
} SunDepths;

/* Velocities of what is seen at points: Flow. */
typedef struct {
    Flow flow;
    int64_t points;
    const double *places;        /* (3, points), in the world */
    const double *times;         /* (points), since the frame */
    double *velocities;          /* (3, points), world units per unit of time */
} FlowVelocities;

/* Optical depths from points towards a lamp: LampOpticalDepth. */
typedef struct {
    const LampColumns *columns;
    int64_t points;
    const float *index;          /* (3, points), continuous */
    double sigma_t;
    float *out;
} LampDepths;

/* Unscattered light of a lamp in cells of a lattice: LampInCube, MeanLampDepth. */
typedef struct {
    int64_t lamp;                /* its parts */
    const LampColumns *const *columns;  /* (lamp), through the cells, whose indices from `first` they take */
    const Emitter *emitters;     /* (lamp) */
    const LampShadowMap *const *shadow_maps;  /* (lamp), each may be NULL */
    int64_t shape[3];            /* of the cells' lattice */
    int64_t first[3];
    int64_t count;
    const int64_t *numbers;      /* (count), of the cells */
    int64_t parts;               /* of a cell along each axis, in whose middles the light is sampled */
    double world[9], offset[3];  /* the world from indices of cells */
    double sigma;
    double radius;               /* by which the light is softened */
    float *light;                /* (count), added to */
    float *open;                 /* the same without attenuation */
} LampBeam;

/* Fluence of a lamp of power 1 at points: LampInMedia. */
typedef struct {
    int64_t points;
    const double *positions;     /* (points, 3), in the world */
    int64_t lamp;                /* number of emitters */
    const Emitter *emitters;     /* (lamp) */
    double *fluence;             /* (points) */
    double *brightest;           /* (points), if each emitter faced each point */
} LampFluence;

/* A lamp near a volume or in it: LampNearby. */
typedef struct {
    int64_t emitters;
    const Emitter *parts;        /* (emitters) */
    double power;                /* factor of its light */
    double place[3];             /* in the cube's frame */
    const float *cells;          /* (edge, edge, edge, 20), the light of nearby_light over `scale` */
    double scale;
    const float *start;          /* optical depths at which light of a soft falloff starts to be scattered, or NULL; */
    double radius, around;       /* SoftStart has these */
} NearbyLamp;

/* Light of lamps nearby that points scatter towards the camera: LampNearby. */
typedef struct {
    int64_t points;
    const double *positions;     /* (points, 3), in the world */
    const float *index;          /* (3, points), positions in cells */
    const float *omega;          /* (3, points), unit vectors along camera rays, in the cube's frame */
    int64_t edge;                /* of the cells, with a cell of padding on each side; at least 3 */
    const float *density;        /* (edge, edge, edge) */
    const float *together;       /* (edge, edge, edge, 4), first four moments of all lamps; NULL for one lamp */
    double low[3], high[3];      /* corners of the volume's box, in the cube's frame */
    int64_t lamps;
    const NearbyLamp *lamp_list; /* (lamps) */
    const float *depths;         /* (lamps, points), optical, of ray features */
    double radius;               /* within which light that turned by small angles is not told apart */
    double joined;               /* part of the fluence below which a lamp's light is not told apart */
    double anisotropy, reduced;  /* of the phase function, and without its forward peak */
    double albedo;
    int64_t terms;               /* of the series of Legendre's polynomials, at least 4 */
    double weights[4];           /* of the difference from a distribution of Henyey and Greenstein's, by degree */
    double straightest, straightest_peak, least;
    float *out;                  /* (points), W/(m^2 sr) */
} NearbyLight;

/* Light that points receive along rays around their camera rays: final_gather. */
typedef struct {
    int64_t points;
    const float *positions;      /* (points, 3), in the cube from -1/2 to 1/2 */
    const float *frames;         /* (points, 3, 3), from the frame of the camera ray to the cube's */
    int64_t rays;                /* a multiple of 8 */
    const float *directions;     /* (3, rays), in the frame of the camera ray */
    int64_t steps;
    double thickness, growth;    /* optical thickness of the first step, and factor by which each may be longer */
    const float *shifts;         /* (3, rays), of positions at which the light is looked up, in its cells */
    const float *media;          /* (edge, edge, edge, 2), density and depth towards the sun, for sigma 1, behind a cell of
                                    padding and before two */
    int64_t edge;
    const float *light;          /* (light_edge, light_edge, light_edge, 4), fluence and flux */
    int64_t light_edge;
    double sigma, flux;          /* extinction; 3 G' */
    float *out;                  /* (points, rays, 4) */
} LightGather;

/* Columns that lie together in the right matrix of a product. */
#define MRPNN_PANEL 16

/* Sum of a product of two matrices and what is added to it: product. */
typedef struct {
    int64_t rows, inner, columns;
    const float *left;           /* (rows, inner) */
    const float *right;          /* (panels, inner, MRPNN_PANEL), 0 beyond `columns` */
    const float *bias;           /* (panels, MRPNN_PANEL), added to each row, 0 beyond `columns` */
    const float *added;          /* (rows, columns), or NULL */
    int64_t rectified;           /* whether sums below 0 become 0 */
    float *out;                  /* (rows, columns) */
} MatrixProduct;

/* Rows of an image whose pixels are joined with those around, as blurred as they are: reconstruction.join. */
typedef struct {
    int64_t rows, columns, values;
    int64_t first, end;          /* rows to fill */
    int64_t reach;               /* pixels that are joined on each side */
    const float *sharpness;      /* (rows, columns, 3), xx, xy and yy of an inverse covariance */
    const float *image;          /* (rows, columns, values) */
    float *joined;               /* (rows, columns, values) */
} PixelJoin;

/* Rays that may meet boxes: Boxes.crossed. */
typedef struct {
    int64_t rays, boxes;
    const double *origins, *directions;         /* (rays, 3) */
    const double *near_distance, *far_distance; /* (rays), what is looked at of each */
    const double *linear, *offset;              /* (boxes, 3, 3) and (boxes, 3), of indices from world positions */
    const double *low, *high;                   /* (boxes, 3), indices */
    const double *steps;                        /* (boxes), per unit of the indices */
    double least;                               /* units that each ray crosses at least */
    double *enter, *leave;                      /* (rays), of all boxes; infinite and in the wrong order on a miss */
    double *counts;                             /* (rays), steps for the box that needs the most */
} BoxCrossings;

/* Triangles onto a raster of points, on each of which the largest value stays: rasterization.rasterize_nearest. */
typedef struct {
    int64_t triangles, rows, columns;
    const double *corners;       /* (triangles, 3, 2), column and row */
    const double *value;         /* (triangles, 3), interpolated linearly */
    const int64_t *first, *last; /* (triangles, 2), column and row, within the raster, of boxes around triangles */
    const int64_t *taken;        /* (triangles), number of each */
    double *largest;             /* (rows, columns) */
    int64_t *number;             /* (rows, columns), of the last triangle with the largest value */
} Raster;

/* Values at cells of a grid from those at known ones, by simple kriging: guided_light. */
typedef struct {
    int64_t values;              /* at each cell */
    const float *known;          /* (known cells, values) */
    const int32_t *numbers;      /* of known cells; elsewhere, and around the grid as far as offsets reach, -1 */
    const float *mean;           /* (values), expected where nothing near by is known */
    int64_t offsets;
    const int32_t *offset;       /* (offsets, 4), steps to cells that are looked at, and their square; nearest first */
    const int64_t *step;         /* (offsets), the same in `numbers` */
    const float *covariance;     /* of two values by the square of their distance, up to twice the longest offset's */
    double noise;                /* variance of known values beside that, above 0 */
    int64_t cells;
    const int64_t *cell;         /* (cells), in `numbers`, whose values are asked */
    float *found;                /* (cells, values) */
} Kriging;

/* Functions of the library that take one structure, which X is told with its type. */
#define MRPNN_FUNCTIONS(X) \
    X(sweep_columns, const ColumnSweep) \
    X(sweep_blocks, const BlockSweep) \
    X(sample_open_depths, const OpenDepthSamples) \
    X(sweep_ahead, const LightAhead) \
    X(sweep_ordinates, const OrdinateSweep) \
    X(sweep_radiance, const RadianceSweep) \
    X(sweep_moments, const MomentSweep) \
    X(follow_peak, const PeakPhotons) \
    X(trace_paths, const LightPaths) \
    X(conjugate_gradients, Diffusion) \
    X(correct_light, const LightCorrection) \
    X(mean_cells, const CellMeans) \
    X(halve, const Halving) \
    X(refine, const Refining) \
    X(fill_lattice, const LatticePart) \
    X(resample, const Resampling) \
    X(fill_lamp_columns, const LampSlices) \
    X(sun_depths, const SunDepths) \
    X(lamp_depths, const LampDepths) \
    X(flow_velocities, const FlowVelocities) \
    X(lamp_beam, const LampBeam) \
    X(lamp_fluence, const LampFluence) \
    X(scatter_nearby, const NearbyLight) \
    X(gather_light, const LightGather) \
    X(join_pixels, const PixelJoin) \
    X(cross_boxes, const BoxCrossings) \
    X(fill_raster, const Raster) \
    X(krige, const Kriging) \
    X(multiply, const MatrixProduct)

#endif
