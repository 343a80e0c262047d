/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Data that Python hands to the compiled kernels; inference/kernels/structures.py reads it from here.

Every number is 8 bytes wide or an array of 8-byte numbers, so that no compiler pads. Pointers are to C-contiguous
arrays of numpy, which the caller keeps alive. Sizes are trusted; what volumes hold is not. */

#ifndef MRPNN_KERNELS_H
#define MRPNN_KERNELS_H

#include <stdint.h>

/* Changes with every change of a structure or of a function's parameters. */
#define MRPNN_INTERFACE 37

/* Colour channels. */
#define MRPNN_CHANNELS 3
/* Intervals of a tabulated phase function. */
#define MRPNN_PHASES 8192

/* A grid of trilinear samples, 0 outside: DenseGrid where table is NULL, SparseGrid otherwise. */
typedef struct {
    const float *values;     /* dense: voxel 0 at index 1 of `size` values; sparse: (rows, 8, 8, 8) */
    const int32_t *table;    /* sparse: (size[0], size[1], size[2]) rows of `values` */
    int64_t size[3];
    int64_t shape[3];        /* voxels */
    int64_t first[3];        /* sparse: position of voxel 0 in the blocks */
    int64_t rows;
} Grid;

/* Cells of a grid that may hold a value other than 0. */
typedef struct {
    const uint8_t *clearance; /* (size[0], size[1], size[2]): 0 for filled cells; cells nearer than this are empty */
    const float *peaks;      /* the same cells: largest density near */
    int64_t size[3];
    double first[3];         /* position of voxel 0 in the cells, in voxels */
    double scale;            /* cells per voxel */
} Occupancy;

/* Velocities that carry what a volume holds while the shutter is open: Flow. */
typedef struct {
    Grid components[3];
    double linear[9], offset[3];  /* continuous indices from world positions */
    double turn[9];          /* velocity in the world from the grids' values */
} Flow;

/* Optical depth through one grid towards one sun: DenseColumns where table is NULL, SparseColumns otherwise. All indices
are of the volume's grid or, where larger voxels serve its shadows, of those. */
typedef struct {
    int64_t octaves;         /* by which voxels are larger than the volume's, */
    Grid density;            /* and their density; unused for 0 */
    const float *depths;     /* dense: (slices, size[0], size[1]); sparse: (tiles, 8, 8) */
    const int32_t *table;    /* sparse: (slices / 8, size[0] / 8, size[1] / 8) */
    const float *offsets;    /* (slices, 2) */
    int64_t slices;
    int64_t size[2];         /* columns */
    int64_t tiles;
    int64_t first;           /* added to the number of a slice of the padded grid */
    int64_t main;            /* the sun's main axis, the others, and the sign of the direction along it */
    int64_t others[2];
    int64_t step;
    int64_t integrated;      /* slices that are integrated; 0: none */
    int64_t everywhere;      /* whether every point is integrated, not only those that the camera and the sun see */
    int64_t steep;           /* whether integrals are split at planes of voxel centres */
    double visible;          /* sum of the optical depths to the camera and the sun up to which points are seen */
    double deepest;          /* optical depth beyond which nothing is integrated */
    double move[3];          /* from one slice to the next, in indices */
    double length;           /* of that displacement in world units */
    double direction[3];     /* d(index)/d(world unit) */
} SunColumns;

/* One volume as rays traverse it: BoundMedium. */
typedef struct {
    Grid density;
    const uint8_t *held;     /* (size[0], size[1], bytes of size[2] bits) of a dense grid's density, lowest bit first: 0
                                where it is 0 from a voxel to the next along all axes; NULL: unknown */
    Occupancy occupancy;
    const SunColumns *suns;  /* (suns) */
    const float *phase;      /* (2, MRPNN_PHASES + 1), phase function by the square root of 1 - |cosine|, forwards and
                                backwards; NULL without lamps */
    double linear[9];        /* continuous indices from world positions */
    double offset[3];
    double sigma_t;
    Grid emission[MRPNN_CHANNELS];  /* of the colour channels that are rendered together */
    int64_t emission_power;
    double emission_factor;  /* 0: the volume emits nothing */
    int64_t varies;          /* whether the albedo varies: then density times albedo, of the channels of scattering, */
    Grid scattering[MRPNN_CHANNELS];
    const double *motion;    /* (eyes, 12), rows of (linear, offset): where the volume is at the frame, of where it is
                                when each eye sees it, in the world; NULL: it stands still */
    Flow flow;               /* where the volume is at the frame, */
    const double *times;     /* and (eyes), times since then at which each eye sees it; NULL: nothing flows */
    double support[6];       /* lowest and highest indices at which rays may meet what it holds */
} Medium;

/* Optical depths of columns around a lamp, within the pyramid about one direction of an axis: LampOpticalDepth. */
typedef struct {
    float *depths;           /* (slices, size[0], size[1]) */
    const double *starts;    /* (slices), their distances from the lamp along the axis, in voxels, ascending */
    int64_t slices;          /* 0: the pyramid holds nothing of the grid */
    int64_t size[2];         /* columns */
    double first[2];         /* slope of the first column, */
    double spacing[2];       /* and from one to the next */
} Pyramid;

/* Optical depth through one grid towards one point. */
typedef struct {
    Grid density;
    Pyramid pyramids[6];     /* around the positive and the negative direction of each axis */
    double lamp[3];          /* in continuous indices */
    double world_from_index[9];
    int64_t integrated;      /* whether depths are integrated from the slice before */
    double centre[3];        /* of the lamp's sphere, in continuous indices, */
    double radius, offset[3];  /* its radius, and the lamp's position less its centre, in the world, */
    int64_t soft_falloff;    /* whether light starts on a disk, */
    double around;           /* the mean density within the sphere, */
    int64_t uneven;          /* whether excess varies with the density on the first part of the way, */
    const float *excess;     /* (EXCESS_NODES), depths to be added at distances d, even in d / (d + radius), or NULL */
} LampColumns;

/* lamp_shadow_map.BLOCK. */
#define MRPNN_SHADOW_BLOCK 16

/* Distance of the nearest surface in all directions from a point: LampShadowMap. */
typedef struct {
    const float *distances;  /* (6, cells, cells) */
    const float *extremes;   /* (6, blocks, blocks, 2), least and largest in squares of MRPNN_SHADOW_BLOCK cells, and in
                                the next row and column */
    int64_t cells, blocks;
    double position[3];
    double frames[54];       /* (6, 3, 3), axes of the faces as columns */
} LampShadowMap;

/* An emitter of a lamp of power 1: SphereEmitter, or QuadEmitter where flat. */
typedef struct {
    int64_t flat;
    double position[3];      /* from which its light seems to come */
    double extent;
    double centre[3];        /* of the sphere */
    double radius, intensity, closest;  /* the last is the square of a distance */
    int64_t soft_falloff;
    int64_t cone;            /* whether the sphere shines into a cone: */
    double axis[3], cosine, width;
    double bound;            /* cosine of the round cone that holds it */
    int64_t elliptic;        /* whether the cone is round in another frame: */
    double frame[9], stretch;  /* the latter is the determinant without its sign */
    double corners[12], normal[3], radiance, area;  /* of the quadrilateral */
    double nodes[12], areas[4];  /* of a quadrature over its surface, */
    double far;              /* and the square of the distance from which on it is used */
    double tangent, focus;   /* of half its spread, and the brightness of its axis; tangent 0: diffuse */
    double focused;          /* divisor of the tangent for the focus */
} Emitter;

/* A lamp. */
typedef struct {
    int64_t emitters;
    const Emitter *parts;            /* (emitters) */
    const LampColumns *const *columns;  /* (emitters, volumes) */
    const LampShadowMap *shadow_maps;  /* (emitters), or NULL where no surface shadows volumes */
    double centre[3], reach;         /* of a sphere around its emitters */
    double smooth;                   /* largest spacing of positions on a ray, over their distance, between which its
                                        light is about linear; 0: none */
    const Grid *mean;                /* optical depth of all its light at the voxels of the only volume, and those around
                                        it; or NULL */
    double mean_from;                /* distance from which on that is used */
} Lamp;

/* Height of the highest surface above each cell of a plane that faces a sun. */
typedef struct {
    const float *heights;    /* (rows, columns) */
    int64_t rows, columns;
    double linear[9];
    double offset[3];
} ShadowMap;

/* Scattered light of each sun or lamp in a group of volumes: ScatteredFluence. */
typedef struct {
    const float *const *lights;     /* of each (cells, cells, cells, 4); NULL for a group without prediction */
    const double *scales;           /* of each, its factor; NULL: 1 */
    int64_t cells;
    double linear[9];
    double offset[3];
    double flux_from_world[9];      /* weights of the flux in the light scattered against a direction */
    double reduced_fraction;
} Fluence;

/* Everything that rays need to know of a scene in some colour channels. */
typedef struct {
    int64_t volumes, suns, groups, channels;
    int64_t flowing;                 /* whether velocities carry what any of the volumes holds */
    int64_t varying, scattering;     /* how many albedos vary, and colour channels whose scattering is gathered */
    const Medium *media;             /* (volumes) */
    const double *spheres;           /* (volumes, 4), centres and radii in the world, around all that a ray may meet of
                                        each; or NULL */
    const double *sun_directions;    /* (suns, 3) in the world; or NULL */
    const int64_t *group_starts;     /* (groups + 1) in `group_members` */
    const int64_t *group_members;    /* numbers of volumes */
    const ShadowMap *shadow_maps;    /* (suns), or NULL where no surface shadows volumes */
    const Fluence *fluence;          /* (groups), or NULL without ray features */
    int64_t lamps;
    const Lamp *lamp_list;           /* (lamps) */
    const Fluence *lamp_fluence;     /* (groups), or NULL without ray features of lamps */
    double lamp_radius;              /* by which lamps are softened in ray features */
    double brief;                    /* length over distance to a lamp up to which steps take a node in their middle, */
    double wide;                     /* and above which they are wide */
    int64_t wide_count;              /* nodes of wide steps, in the angle under which the lamp sees them */
    const double *wide_nodes, *wide_weights;  /* in [0, 1] */
    const double *nodes;             /* (depth_samples + 1, depth_samples), Gauss-Legendre nodes of each count */
    const double *node_weights;
    int64_t depth_samples, most_detail, adaptive, coarse_count;
    int64_t skip_empty;
    int64_t at_start;                /* whether each ray has one depth sample, where it begins */
    double step_thickness;           /* optical thickness that steps may have where a ray begins, */
    double step_growth;              /* and the optical depth over which that grows by e; */
    double peak_thickness;           /* the same of steps as dense as the densest voxel near, which are not cut below */
    double peak_growth, finest;      /* a fraction of a coarse step */
    double behind, behind_emission;  /* optical depths up to which rays are marched */
    double min_alpha;
    double dark;
    double max_tau_sun, max_tau_ahead;
    double scales[3];
    double jitter[3];
} Scene;

typedef struct {
    int64_t rays;
    const double *origins, *directions;  /* (rays, 3) */
    const double *near_distance, *far_distance;  /* (rays) */
    const int64_t *counts;               /* (rays), number of steps */
    const int64_t *eyes;                 /* (rays), of those by which volumes move, or NULL: all stand still */
    const int64_t *detail;               /* (rays), times as many depth samples, at most `most_detail`, or NULL: once */
    int64_t max_count;                   /* no count may be larger: `scratch` is made for it */
    int64_t most_met;                    /* volumes that one ray meets at most, of scratch_bytes */
    const volatile int32_t *stop;        /* not 0: return as soon as possible */
    void *scratch;
} Rays;

/* Results of marching; the samples of all rays follow one another. */
typedef struct {
    double *alpha, *depth;               /* (rays) */
    double *optical_depth;               /* (rays, volumes) */
    double *single_scattering;           /* (rays, volumes, suns, scattering) */
    double *lamp_scattering;             /* (rays, volumes, lamps, scattering), of lamps of power 1 */
    double *scattering_depth;            /* (rays, volumes, scattering), or NULL where no albedo varies */
    double *emission;                    /* (rays, channels), or NULL */
    int64_t *sample_counts;              /* (rays) */
    double *sample_distance, *sample_weight;  /* (S), S = rays * depth_samples * most_detail */
    float *sample_fraction;              /* (S, volumes) */
    float *sample_scattering;            /* (S, volumes, scattering), or NULL where none varies */
    float *sample_features;              /* (S, groups, suns, 7), or NULL */
    float *lamp_features;                /* (S, groups, lamps, 7), or NULL */
    int64_t samples;
    int64_t blocks;                      /* blocks of steps evaluated */
} Gathered;

#endif
