/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Loads a library of kernels, runs every variant on cases whose results are known, and says what is wrong.

kernel_check LIBRARY; the exit status is the number of faults. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "fields.h"

#if defined(_WIN32)
#include <windows.h>
static void *load(const char *path) { return (void *)LoadLibraryA(path); }
static void *find(void *library, const char *name) { return (void *)GetProcAddress((HMODULE)library, name); }
#else
#include <dlfcn.h>
static void *load(const char *path) { return dlopen(path, RTLD_NOW); }
static void *find(void *library, const char *name) { return dlsym(library, name); }
#endif

#define N 8
#define PADDED (N + 3)
#define COLUMNS (PADDED + 3)

static void *library;
static int faults;

static void expect(const char *what, int64_t variant, double found, double expected, double tolerance) {
    if (fabs(found - expected) <= tolerance) return;
    printf("%s, variant %d: %.9g instead of %.9g\n", what, (int)variant, found, expected);
    faults++;
}

static void *need(const char *name) {
    void *function = find(library, name);
    if (!function) {
        printf("there is no %s\n", name);
        exit(1);
    }
    return function;
}

typedef int64_t (*Prepare)(int64_t, void *);

static void prepare(const char *name, int64_t variant, void *data) { ((Prepare)need(name))(variant, data); }

/* The optical depth in a homogeneous cube, from each column to its top. */
static float *check_columns(int64_t variant, const float *padded) {
    static float depths[(PADDED + 2) * COLUMNS * COLUMNS], columns[COLUMNS * COLUMNS], scratch[COLUMNS * COLUMNS + 32];
    int64_t slices[PADDED], starts[2 * PADDED] = {0};
    float weights[8 * PADDED] = {0.0f};
    for (int n = 0; n < PADDED; n++) slices[n] = PADDED - 1 - n, weights[8 * n + 1] = weights[8 * n + 5] = 1.0f;
    for (int n = 0; n < COLUMNS * COLUMNS; n++) columns[n] = 0.0f;
    ColumnSweep sweep = {.density = padded, .shape = {PADDED, PADDED, PADDED}, .strides = {PADDED * PADDED, PADDED, 1},
                         .count = PADDED, .slices = slices, .starts = starts, .weights = weights, .half_step = 0.5,
                         .columns = columns, .size = {COLUMNS, COLUMNS}, .depths = depths + COLUMNS * COLUMNS,
                         .depth_strides = {COLUMNS * COLUMNS, COLUMNS, 1}, .scratch = scratch};
    prepare("mrpnn_sweep_columns", variant, &sweep);
    /* Weight 1 of four neighbours moves cells by 2. */
    for (int k = 0; k < N; k++) {
        float found = depths[((k + 2) * COLUMNS + 1 + N / 2 + 2) * COLUMNS + 1 + N / 2 + 2];
        expect("sweep_columns", variant, found, N - 0.5 - k, 1e-5);
    }
    return depths;
}

/* A ray through a homogeneous cube, towards whose first face the sun shines. */
static void check_march(int64_t variant, const float *padded, const float *depths) {
    static float offsets[2 * (PADDED + 2)];
    static uint8_t clearance[64];
    static float peaks[64];
    for (int n = 0; n < PADDED + 2; n++) offsets[2 * n] = offsets[2 * n + 1] = 2.0f;
    for (int n = 0; n < 64; n++) peaks[n] = 1.0f;
    SunColumns sun = {.depths = depths, .offsets = offsets, .slices = PADDED + 2, .size = {COLUMNS, COLUMNS},
                      .first = 1, .main = 0, .others = {1, 2}, .step = 1, .move = {1.0, 0.0, 0.0}, .length = 1.0,
                      .direction = {1.0, 0.0, 0.0}};
    Medium medium = {.density = {.values = padded, .size = {PADDED, PADDED, PADDED}, .shape = {N, N, N}},
                     .occupancy = {.clearance = clearance, .peaks = peaks, .size = {4, 4, 4}, .first = {1.0, 1.0, 1.0}, .scale = 1.0 / 3.0},
                     .suns = &sun, .linear = {1, 0, 0, 0, 1, 0, 0, 0, 1}, .sigma_t = 0.05};
    int64_t group_starts[2] = {0, 1}, members[1] = {0}, counts[1] = {400}, sample_counts[1];
    double nodes[4] = {0.0, 0.0, 0.5, 0.0}, weights[4] = {0.0, 0.0, 1.0, 0.0};
    Scene scene = {.volumes = 1, .suns = 1, .groups = 1, .channels = 1, .scattering = 1, .media = &medium, .group_starts = group_starts,
                   .group_members = members, .nodes = nodes + 1, .node_weights = weights + 1, .depth_samples = 1,
                   .coarse_count = 16, .skip_empty = 1, .step_thickness = 0.3, .step_growth = 8.0,
                   .peak_thickness = 0.3, .peak_growth = 3.0, .finest = 0.0625, .behind = INFINITY, .behind_emission = INFINITY, .dark = 80.0,
                   .max_tau_sun = 60.0, .max_tau_ahead = 8.0, .scales = {1.0, 0.578, 0.334}};
    double origin[3] = {-2.0, N / 2, N / 2}, direction[3] = {1.0, 0.0, 0.0}, near_distance = 0.0, far_distance = N + 3.0;
    int64_t (*scratch_bytes)(const Scene *, Rays *) = (int64_t(*)(const Scene *, Rays *))need("mrpnn_scratch_bytes");
    int64_t (*march)(int64_t, const Scene *, const Rays *, Gathered *) =
        (int64_t(*)(int64_t, const Scene *, const Rays *, Gathered *))need("mrpnn_march");
    Rays rays = {.rays = 1, .origins = origin, .directions = direction, .near_distance = &near_distance,
                 .far_distance = &far_distance, .counts = counts, .max_count = 400};
    rays.scratch = malloc((size_t)scratch_bytes(&scene, &rays));
    double alpha, depth, optical_depth, single, distance, weight;
    float fraction;
    Gathered out = {.alpha = &alpha, .depth = &depth, .optical_depth = &optical_depth, .single_scattering = &single,
                    .sample_counts = sample_counts, .sample_distance = &distance, .sample_weight = &weight,
                    .sample_fraction = &fraction};
    march(variant, &scene, &rays, &out);
    free(rays.scratch);
    expect("march: opacity", variant, alpha, 1.0 - exp(-0.05 * N), 1e-4);
    expect("march: depth samples", variant, (double)out.samples, 1.0, 0.0);
    /* Where the ray's transmittance falls, that towards the sun rises: exp(-a) exp(-(tau - a)). */
    expect("march: single scattering", variant, single, 0.05 * N * exp(-0.05 * N), 2e-3);
}

/* A sweep without sources keeps nothing, and one of thin cells adds what they emit. */
static void check_ordinates(int64_t variant) {
    enum { CELLS = 8, CUBE = CELLS * CELLS * CELLS };
    static float field[5 * CUBE], leaving[3 * CUBE], within[3 * CUBE], sums[4 * CUBE], scratch[8192];
    int64_t steps[2] = {0, 0}, kinds[1] = {0};
    float emit[5] = {1.0f, 0.0f, 0.0f, 0.0f, 0.0f}, gather[4] = {1.0f, 0.0f, 0.0f, 1.0f};
    for (int n = 0; n < CUBE; n++) field[n] = 1.0f, sums[n] = sums[3 * CUBE + n] = 0.0f;
    for (int n = 0; n < 3 * CUBE; n++) leaving[n] = 0.5f, within[n] = 0.25f;
    OrdinateSweep sweep = {.cells = CELLS, .axis = 2, .sign = 1, .directions = 1, .steps = steps, .kinds = kinds,
                           .emit = emit, .gather = gather, .field = field, .leaving = leaving, .within = within,
                           .sums = sums, .scratch = scratch};
    prepare("mrpnn_sweep_ordinates", variant, &sweep);
    for (int k = 0; k < CELLS; k++) {
        expect("sweep_ordinates", variant, sums[3 * CUBE + 9 * CELLS + k], 1.0 - 0.75 * pow(0.5, k), 1e-6);
    }
}

static void check_gradients(int64_t variant) {
    double diagonal[3] = {2.0, 2.0, 2.0}, couplings[9] = {1.0, 1.0, 0.0}, x[3] = {0.0}, residual[3] = {1.0, 0.0, 1.0};
    double direction[3] = {0.5, 0.0, 0.5}, product[3];
    Diffusion system = {.shape = {3, 1, 1}, .diagonal = diagonal, .couplings = couplings, .x = x, .residual = residual,
                        .direction = direction, .product = product, .rz = 1.0, .limit = 1e-20, .iterations = 10};
    prepare("mrpnn_conjugate_gradients", variant, &system);
    for (int n = 0; n < 3; n++) expect("conjugate_gradients", variant, x[n], 1.0, 1e-9);
}

/* Fluence that rises along the last axis flows back, at most as much as the field has. */
static void check_correction(int64_t variant) {
    float fluence[8], diffusion[8], field[32] = {0.0f};
    for (int n = 0; n < 8; n++) fluence[n] = (float)(1 + n % 2), diffusion[n] = 0.25f;
    LightCorrection light = {.cells = 2, .fluence = fluence, .diffusion = diffusion, .field = field, .limited = 1, .most_flux = 3.0};
    prepare("mrpnn_correct_light", variant, &light);
    expect("correct_light", variant, field[1], 2.0, 1e-6);
    expect("correct_light", variant, field[24], -1.0 / 3.0, 1e-6);
    expect("correct_light", variant, field[25], -0.5, 1e-6);
}

static void check_pyramid(int64_t variant) {
    float fine[64], coarse[8];
    for (int n = 0; n < 64; n++) fine[n] = (float)n;
    Halving levels = {.fine = fine, .fine_strides = {16, 4}, .coarse = coarse, .coarse_strides = {4, 2}, .size = {2, 2, 2}};
    prepare("mrpnn_halve", variant, &levels);
    expect("halve", variant, coarse[0], 10.5, 1e-6);
    float refined[64], slice[6];
    Refining cells = {.coarse = coarse, .size = {2, 2, 2}, .fine = refined, .scratch = slice};
    prepare("mrpnn_refine", variant, &cells);
    expect("refine", variant, refined[0], 10.5, 1e-6);
    expect("refine", variant, refined[21], 0.75 * coarse[0] + 0.25 * coarse[7], 1e-5);
    int32_t below[2] = {0, 2};
    float fraction[2] = {0.5f, 0.25f}, scratch[32];
    uint16_t packed[8];
    Refinement grid = {.values = fine, .shape = {4, 4, 4}, .below = {below, below, below}, .fraction = {fraction, fraction, fraction}};
    LatticePart part = {.shape = {2, 2, 2}, .density = grid, .density_scale = 0.1, .density_step = 1e-4,
                        .packed = packed, .scratch = scratch};
    prepare("mrpnn_fill_lattice", variant, &part);
    expect("fill_lattice", variant, packed[0], log(1.0 + 0.1 * 10.5) / 1e-4, 1.0);
    expect("fill_lattice", variant, packed[7], log(1.0 + 0.1 * 47.25) / 1e-4, 1.0);
}

/* A layer of a network in whole numbers, which every processor adds alike: more rows and columns than a tile has. */
static void check_products(int64_t variant) {
    enum { ROWS = 29, INNER = 5, WIDTH = 2 * MRPNN_PANEL + 3, PANELS = 3 };
    static float left[ROWS * INNER], right[PANELS * INNER * MRPNN_PANEL], bias[PANELS * MRPNN_PANEL];
    static float added[ROWS * WIDTH], out[ROWS * WIDTH];
    for (int n = 0; n < ROWS * INNER; n++) left[n] = (float)(n % 7 - 3);
    for (int n = 0; n < ROWS * WIDTH; n++) added[n] = (float)(n % 11 - 5);
    for (int column = 0; column < WIDTH; column++) {
        bias[column] = (float)(column % 3);
        for (int k = 0; k < INNER; k++)
            right[(column / MRPNN_PANEL * INNER + k) * MRPNN_PANEL + column % MRPNN_PANEL] = (float)((k + 2 * column) % 5 - 2);
    }
    MatrixProduct layer = {.rows = ROWS, .inner = INNER, .columns = WIDTH, .left = left, .right = right, .bias = bias,
                           .added = added, .rectified = 1, .out = out};
    prepare("mrpnn_multiply", variant, &layer);
    for (int row = 0; row < ROWS; row++)
        for (int column = 0; column < WIDTH; column++) {
            float sum = bias[column] + added[row * WIDTH + column];
            for (int k = 0; k < INNER; k++) sum += left[row * INNER + k] * (float)((k + 2 * column) % 5 - 2);
            expect("multiply", variant, out[row * WIDTH + column], sum > 0.0f ? sum : 0.0f, 0.0);
        }
}

#if defined(_WIN32)
/* An update replaces the file of a library: Windows forbids that while it is loaded, and allows it once it is freed. */
static void check_replacing(const char *path) {
    const char *copy = "kernel_check_copy.dll";
    CopyFileA(path, copy, FALSE);
    HMODULE loaded = LoadLibraryA(copy);
    expect("loaded", 0, loaded != NULL, 1, 0.0);
    expect("deleted while loaded", 0, DeleteFileA(copy) != 0, 0, 0.0);
    FreeLibrary(loaded);
    expect("deleted once freed", 0, DeleteFileA(copy) != 0, 1, 0.0);
}
#endif

int main(int count, char **arguments) {
    if (count != 2 || !(library = load(arguments[1]))) {
        printf("the library cannot be loaded\n");
        return 1;
    }
    int64_t number = ((int64_t(*)(void))need("mrpnn_interface"))();
    int64_t best = ((int64_t(*)(void))need("mrpnn_best_variant"))();
    static float padded[PADDED * PADDED * PADDED];
    for (int n = 0; n < N * N * N; n++) padded[((n / N / N + 1) * PADDED + n / N % N + 1) * PADDED + n % N + 1] = 1.0f;
    expect("number", 0, (double)number, MRPNN_INTERFACE, 0.0);
    for (int64_t variant = 0; variant <= best; variant++) {
        float *depths = check_columns(variant, padded);
        check_march(variant, padded, depths);
        check_ordinates(variant);
        check_gradients(variant);
        check_correction(variant);
        check_pyramid(variant);
        check_products(variant);
    }
#if defined(_WIN32)
    check_replacing(arguments[1]);
#endif
    printf("%d variants, %d faults\n", (int)best + 1, faults);
    return faults;
}
